"""`python -m saver_advisors.cli`, the same as `saver`."""

import sys

from saver_advisors.cli import main

if __name__ == "__main__":
    sys.exit(main())
