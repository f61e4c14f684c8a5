"""What evolves in a run, by name: enough to go on from, and nothing that follows from it.

A state is a dictionary of arrays. Nodes, stencils and parameters are set up from the scene again; operator weights are
computed again at the places that they were last computed at (`built_place`); what a step overwrites before it reads it
is left out. `Snapshot` copies the fields named to and from arrays, all of them in one kernel each way: a copy of each
field would compile a kernel for each.
"""

import numpy as np

from taichi_eye.lang import ti

State = dict[str, np.ndarray]


class Snapshot:
    """Fields of nodes and of eyes, read and written together.

    nodes, eyes: fields by name, of scalars, vectors or matrices, whole arrays of a node (first dimension of the
    capacity) and of an eye. A state holds each as [nodes, components] or [eyes, components] of doubles.
    """

    def __init__(self, nodes: dict, eyes: dict):
        self._parts = {"node": _Part(nodes), "eye": _Part(eyes)}

    def take(self, nodes: int, eyes: int) -> State:
        """The fields of the first so many nodes and eyes."""
        return {**self._parts["node"].take(nodes), **self._parts["eye"].take(eyes)}

    def put(self, state: State) -> None:
        """Write the fields back; KeyError or ValueError where one is missing or has another shape."""
        for part in self._parts.values():
            part.put(state)


class _Part:
    """Fields of one length."""

    def __init__(self, fields: dict):
        self._widths = {name: _width(field) for name, field in fields.items()}
        self._columns = sum(self._widths.values())
        self._read, self._write = _copies(list(fields.values()), list(self._widths.values()))

    def take(self, count: int) -> State:
        whole = np.zeros((count, self._columns))
        self._read(whole)
        ends = np.cumsum(list(self._widths.values()))
        return dict(zip(self._widths, (part.copy() for part in np.split(whole, ends[:-1], axis=1))))

    def put(self, state: State) -> None:
        for name, width in self._widths.items():
            if state[name].ndim != 2 or state[name].shape[1] != width:
                raise ValueError(f"{name} has the shape {state[name].shape}, {width} columns are expected")
        self._write(np.ascontiguousarray(np.concatenate([state[name] for name in self._widths], axis=1), dtype=float))


def _width(field) -> int:
    return getattr(field, "n", 1) * getattr(field, "m", 1)


def _copies(fields, widths):
    """Kernels that read all fields into an array [count, columns] and write them back."""
    starts = [sum(widths[:k]) for k in range(len(widths))]
    scalars, vectors, matrices = [], [], []
    for field, width, start in zip(fields, widths, starts):
        kind = scalars if width == 1 and not hasattr(field, "n") else vectors if field.m == 1 else matrices
        kind.append((field, start))
    scalars, scalar_at = tuple(field for field, _ in scalars), tuple(start for _, start in scalars)
    vectors, vector_at = tuple(field for field, _ in vectors), tuple(start for _, start in vectors)
    matrices, matrix_at = tuple(field for field, _ in matrices), tuple(start for _, start in matrices)

    @ti.kernel
    def read(out: ti.types.ndarray()):
        for i in range(out.shape[0]):
            for q in ti.static(range(len(scalars))):
                out[i, scalar_at[q]] = scalars[q][i]
            for q in ti.static(range(len(vectors))):
                for k in ti.static(range(vectors[q].n)):
                    out[i, vector_at[q] + k] = vectors[q][i][k]
            for q in ti.static(range(len(matrices))):
                for k in ti.static(range(matrices[q].n)):
                    for m in ti.static(range(matrices[q].m)):
                        out[i, matrix_at[q] + k * matrices[q].m + m] = matrices[q][i][k, m]

    @ti.kernel
    def write(given: ti.types.ndarray()):
        for i in range(given.shape[0]):
            for q in ti.static(range(len(scalars))):
                scalars[q][i] = given[i, scalar_at[q]]
            for q in ti.static(range(len(vectors))):
                for k in ti.static(range(vectors[q].n)):
                    vectors[q][i][k] = given[i, vector_at[q] + k]
            for q in ti.static(range(len(matrices))):
                for k in ti.static(range(matrices[q].n)):
                    for m in ti.static(range(matrices[q].m)):
                        matrices[q][i][k, m] = given[i, matrix_at[q] + k * matrices[q].m + m]

    return read, write
