"""The ``cyclofeat`` command as a process of its own; ``python -m cyclofeat`` is the same."""

import signal
import sys
from types import FrameType
from typing import NoReturn


class _CtrlC:
    """Handler of Ctrl-C that remembers it: a compiled module cut off in its import raises another error."""

    pressed = False

    def __call__(self, number: int, frame: FrameType | None) -> NoReturn:
        self.pressed = True
        raise KeyboardInterrupt


def main() -> int:
    """Run the command line and return the exit status; see :func:`cyclofeat.cli.main`."""
    # A shell's background job ignores the keyboard.
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ctrl_c = _CtrlC()
    if heard:
        signal.signal(signal.SIGINT, ctrl_c)
    try:
        from cyclofeat.cli import main

        status = main()
    except BaseException:
        if not ctrl_c.pressed:
            raise
        print("cyclofeat: interrupted", file=sys.stderr)
        status = 130
    if heard:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # what is left is the end of the interpreter
    return 130 if ctrl_c.pressed else status


if __name__ == "__main__":
    sys.exit(main())
