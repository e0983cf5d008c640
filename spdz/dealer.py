"""``python -m spdz.dealer``: a door to the package ``dealer``."""

import sys


def main() -> int:
    """Run the dealer's command line."""
    from dealer.cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
