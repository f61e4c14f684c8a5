"""`python -m taichi_eye` is `taichi-eye`."""

import sys

from taichi_eye.cli import main

sys.exit(main())
