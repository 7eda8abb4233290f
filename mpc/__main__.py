"""The command `antagonist` runs from here, as `python -m mpc` too."""

import sys


def main() -> None:
    """Run the command; who interrupts it while it still loads reads one word too."""
    try:
        from mpc.cli import main as run

        run()
    except KeyboardInterrupt:
        print("antagonist: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()

__all__ = ["main"]
