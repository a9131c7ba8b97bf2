from modal_id import flags


def test_every_flag_is_registered_once_with_a_description():
    defined = [value for value in vars(flags).values() if isinstance(value, flags.ModeFlag)]
    assert list(flags.REGISTRY) == defined
    assert len({flag.name for flag in defined}) == len(defined)
    assert all(len(flag.description) > 20 and flag.description.endswith(".") for flag in defined)
