"""Entry point of the command ``modalcam`` and of ``python -m modalcam``.

It imports nothing until it has taken charge of interrupts: an interrupt of the imports would end in their traceback.
"""

import atexit
import gc
import os
import signal
import sys
from types import FrameType


def main() -> None:
    """Run the command line; an interrupt before the command begins ends at once, since there is nothing to save."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # Closed by the caller: the next file to be opened would take its place and receive the messages.
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, PTH123 - stays open
    # At the end Python would search all libraries for garbage several times, which takes half a second.
    atexit.register(gc.freeze)
    waiting = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if waiting:
        signal.signal(signal.SIGINT, _end)
    from modalcam import cli  # noqa: PLC0415

    if waiting:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.main()


def _end(number: int, _: FrameType | None) -> None:
    os.write(2, b"modalcam: interrupted; run the same command again to continue\n")
    os._exit(128 + number)


if __name__ == "__main__":
    main()
