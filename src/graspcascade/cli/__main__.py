"""Run the command line as ``python -m graspcascade.cli``."""

import sys

from .main import main

sys.exit(main())
