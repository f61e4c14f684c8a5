"""Columns as a table of pandas, which is loaded only for whoever asks for one."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec

import numpy as np

from taichi_eye.errors import SceneError


def framed(columns: Mapping[str, np.ndarray]):
    """A pandas DataFrame of columns; SceneError where pandas is not installed."""
    if find_spec("pandas") is None:
        raise SceneError(
            "pandas is not installed, which tables of results need: pip install 'taichi-eye[studies]' (the arrays "
            "themselves are there without it)"
        )
    import pandas

    return pandas.DataFrame(dict(columns))
