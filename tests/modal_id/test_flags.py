from modal_id import ModeFlag


def test_every_flag_has_its_own_description():
    # Iteration skips aliases.
    assert list(ModeFlag.__members__) == [flag.name for flag in ModeFlag]
    assert all(len(flag.value) > 20 and flag.value.endswith(".") for flag in ModeFlag)
