"""Node fields for ParaView: one .vtu per frame and part, and .pvd collections that hold them with their times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np

from taichi_eye.report.folder import replacing, write_text

PARTS = "fluid", "membrane"


class ParaviewWriter:
    """Writes the fluid nodes (as triangles) and the membrane (as a line) of each frame into a folder.

    `fields.pvd` is rewritten after every frame and names only finished files, so that an interrupted run opens. Points
    are (r, z, 0) in metres, vectors likewise; the time of the collection is in ms.
    """

    def __init__(self, folder: Path, times_ms: Iterable[float] = ()):
        """Creates `folder`; times_ms: those of the frames that it holds already, the later ones being made anew."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self.times_ms = list(times_ms)

    def add_frame(
        self,
        time_ms: float,
        nodes: np.ndarray,
        triangles: np.ndarray,
        fields: Mapping[str, np.ndarray],
        membrane: np.ndarray,
        membrane_fields: Mapping[str, np.ndarray],
    ) -> None:
        """Write one frame.

        nodes: fluid nodes, shape [n, 2], m; triangles over them, shape [t, 3]; fields on them, shape [n] or [n, 2].
        membrane: points from apex to limbus, shape [m, 2], m, with fields of shape [m] or [m, 2]. Names of fields carry
        their units.
        """
        line = np.column_stack([np.arange(len(membrane) - 1), np.arange(1, len(membrane))])
        fluid, wall = PARTS
        parts = (fluid, nodes, "triangle", triangles, fields), (wall, membrane, "line", line, membrane_fields)
        for part, points, kind, cells, data in parts:
            name = _file(part, len(self.times_ms))
            mesh = meshio.Mesh(
                _flat(points),
                [(kind, np.asarray(cells))],
                point_data={key: _flat(value) for key, value in data.items()},
            )
            with replacing(self._folder / name) as temporary:
                mesh.write(temporary, file_format="vtu")
        self.times_ms.append(float(time_ms))
        entries = [
            f'    <DataSet timestep="{time!r}" group="" part="{index}" '
            f"name={quoteattr(part)} file={quoteattr(_file(part, frame))}/>"
            for frame, time in enumerate(self.times_ms)
            for index, part in enumerate(PARTS)
        ]
        write_text(
            self._folder / "fields.pvd",
            "\n".join(
                [
                    '<?xml version="1.0"?>',
                    '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
                    "  <Collection>",
                    *entries,
                    "  </Collection>",
                    "</VTKFile>",
                    "",
                ]
            ),
        )


def _file(part: str, frame: int) -> str:
    return f"{part}-{frame:04d}.vtu"


def _flat(values: np.ndarray) -> np.ndarray:
    """(r, z) pairs as (r, z, 0); scalars as they are; always double precision."""
    values = np.asarray(values, dtype=float)
    return values if values.ndim == 1 else np.column_stack([values, np.zeros(len(values))])
