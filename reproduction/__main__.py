"""`python -m reproduction NAME`: regenerate figures and pages of the dissertation."""

from __future__ import annotations

import sys

from reproduction.program import main

if __name__ == "__main__":
    sys.exit(main())
