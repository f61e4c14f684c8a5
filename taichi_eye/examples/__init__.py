"""Worked examples of some forty lines each, to read, run and copy: `python -m taichi_eye.examples.iop_chart`."""
