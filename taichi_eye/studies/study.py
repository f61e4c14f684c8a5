"""Study files: a scene, what is set and what varies in it, and the design. Checked like a scene file, in one message.

    scene = "../corvis_healthy.toml"       # relative to this file; left out: the default eye
    show = ["deformation_amplitude_mm"]    # what the plots show; left out: DA, A1 time and velocity, PD

    [design]
    kind = "latin_hypercube"               # see KINDS
    eyes = 1000
    seed = 1
    correlations = [["eye.iop_mmhg", "cornea.thickness_mm", 0.3]]

    [set]                                  # in every eye
    numerics.fidelity = "cavity"

    [vary]                                 # laws: `taichi_eye.studies.laws`
    eye.iop_mmhg = { mean = 15, sd = 2.5 }
    cornea.thickness_mm = { mean = 0.55, sd = 0.031 }
    cornea.limbus_thickness_mm = { follows = "cornea.thickness_mm", keeping = "difference" }

A design of kind "table" takes its eyes from `file`, a CSV or Parquet file with a column for each key ("eye.iop_mmhg");
columns whose names have no dot are carried into the study's table as text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from taichi_eye import shipped
from taichi_eye.errors import SceneError
from taichi_eye.scene import Scene, load_scene
from taichi_eye.scene.draft import nearest, written
from taichi_eye.scene.load import read_toml
from taichi_eye.scene.schema import AUTO, all_keys
from taichi_eye.scene.table import number, read_cells
from taichi_eye.studies.columns import FIGURES
from taichi_eye.studies.laws import BadLaw, Choice, Follower, Law, read_law

EYES_MAX = 1_000_000
SHOWN = ("deformation_amplitude_mm", "a1_time_ms", "a1_velocity_m_s", "peak_distance_mm")
# kind -> what it draws, and the keys of [design] that it takes beside `kind`
KINDS = {
    "grid": ("every level of each key with every level of the others", ()),
    "one_at_a_time": ("the scene's own eye, then each key through its levels alone", ()),
    "random": ("independent draws", ("eyes", "seed", "correlations")),
    "latin_hypercube": ("each key in equal strata, one eye in each", ("eyes", "seed", "correlations")),
    "sobol": ("a scrambled Sobol sequence", ("eyes", "seed", "correlations")),
    "sensitivity": ("Saltelli's scheme on a Sobol sequence, for Sobol indices", ("base_samples", "seed")),
    "table": ("the rows of a file", ("file",)),
}
LEVELLED = "grid", "one_at_a_time"


@dataclass(frozen=True, eq=False)
class Study:
    """A study as it was read, everything relative made absolute.

    base: the scene that the eyes differ from; kind, eyes, seed: of the design (eyes: base samples of a sensitivity
    study); vary, followers: laws by key; correlations: (key, key, of their normal scores); show: columns of the plots;
    table, labels: of a design from a file, its columns by key and those that are carried along.
    """

    name: str
    base: Scene
    kind: str
    vary: Mapping[str, Law]
    followers: Mapping[str, Follower] = field(default_factory=dict)
    eyes: int = 0
    seed: int = 1
    correlations: tuple[tuple[str, str, float], ...] = ()
    show: tuple[str, ...] = SHOWN
    table: Mapping[str, np.ndarray] | None = None
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def keys(self) -> list[str]:
        """The keys that differ from eye to eye, in order: columns of the table."""
        return [*(self.table if self.table is not None else self.vary), *self.followers]

    @property
    def factors(self) -> list[str]:
        """Those that vary by themselves."""
        return [name for name in self.keys if name not in self.followers]

    def plain(self) -> dict[str, Any]:
        """Everything but the scene and the rows of a file, for JSON; `of_plain` reads it back."""
        design: dict[str, Any] = {"kind": self.kind}
        if self.kind == "table":
            design["file"] = "design.csv"
        elif "seed" in KINDS[self.kind][1]:
            design |= {"base_samples" if self.kind == "sensitivity" else "eyes": self.eyes, "seed": self.seed}
        if self.correlations:
            design["correlations"] = [list(entry) for entry in self.correlations]
        laws = {} if self.table is not None else {name: law.plain() for name, law in self.vary.items()}
        laws |= {name: law.plain() for name, law in self.followers.items()}
        return {"design": design, "show": list(self.show), "vary": laws}

    def text(self) -> str:
        """The study as a file that stands beside its scene.toml and, for a design from a file, its design.csv."""
        plain = self.plain()
        lines = [
            "# The study as it was read, everything relative made absolute.",
            'scene = "scene.toml"',
            f"show = {_toml(plain['show'])}",
            "",
            "[design]",
            *(f"{name} = {_toml(value)}" for name, value in plain["design"].items()),
        ]
        if plain["vary"]:
            lines += ["", "[vary]", *(f"{name} = {_toml(law)}" for name, law in plain["vary"].items())]
        return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {_toml(one)}" for name, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(one) for one in value) + "]"
    return written(value)


def load_study(
    source: str | Path | Mapping[str, Any], scene: Scene | None = None, overrides: Sequence[str] = ()
) -> Study:
    """Read and check a study.

    source: a study file, the name of one that ships, or what one holds as a dictionary (paths in it are then relative
    to the current folder). scene: in place of the one that the study names. overrides: "section.key=value" on top of
    [set]. Raises SceneError with every problem found.
    """
    if isinstance(source, Mapping):
        return _Reader("study", Path(), source).study("study", scene, overrides)
    path = shipped.find(source, shipped.STUDIES)
    return _Reader(str(path), path.parent, read_toml(path)).study(path.stem, scene, overrides)


def of_plain(plain: Mapping[str, Any], base: Scene, name: str, keys: Sequence[str]) -> Study:
    """The study that `Study.plain` was made of; keys: of a design from a file, whose rows are kept elsewhere."""
    reader = _Reader("study", Path(), plain)
    if plain["design"]["kind"] != "table":
        return reader.study(name, base, ())
    vary, followers = reader.laws(base)
    reader.stop_if_refused()
    rows = {key: np.zeros(0) for key in keys if key not in followers}
    return Study(name, base, "table", vary, followers, show=tuple(plain["show"]), table=rows)


class _Reader:
    """A study file in the reading; problems: what was found wrong so far."""

    def __init__(self, where: str, folder: Path, content: Mapping[str, Any]):
        self.where, self.folder, self.content = where, folder, content
        self.problems: list[str] = []
        self.known = {name: (kind, spec) for name, kind, spec in all_keys()}

    def refuse(self, what: str) -> None:
        """Record a problem."""
        self.problems.append(f"{self.where}: {what}")

    def stop_if_refused(self) -> None:
        """SceneError where there are problems."""
        if self.problems:
            raise SceneError("\n".join(self.problems))

    def study(self, name: str, scene: Scene | None, overrides: Sequence[str]) -> Study:
        """The study that the content says."""
        for entry in self.content:
            if entry not in ("scene", "show", "design", "set", "vary"):
                self.refuse(f"{entry}: unknown; a study holds scene, show, [design], [set] and [vary]")
        base = self._base(scene, overrides)
        kind, eyes, seed = self._design()
        show = self._show()
        self.stop_if_refused()
        vary, followers = self.laws(base)
        table, labels = self._file(base) if kind == "table" else (None, {})
        self.stop_if_refused()
        correlations = self._correlations(vary)
        self._check(kind, vary, followers, table)
        self.stop_if_refused()
        study = Study(name, base, kind, vary, followers, eyes, seed, correlations, show, table, labels)
        count = _count(study)
        if not 1 <= count <= EYES_MAX:
            raise SceneError(f"{self.where}: [design] makes {count} eyes; 1 to {EYES_MAX} are allowed")
        return study

    def _base(self, scene: Scene | None, overrides: Sequence[str]) -> Scene:
        fixed = self._fixed()
        named = self.content.get("scene")
        if named is not None and not isinstance(named, str):
            self.refuse(f"scene = {written(named)}: must name a scene file")
        self.stop_if_refused()
        if scene is not None:
            return scene.but(fixed)
        path = None if named is None else self.folder / named
        words = [f"{name}={written(value)}" for name, value in fixed.items()]
        load_scene(path)
        try:
            load_scene(path, words)
        except SceneError as error:
            raise SceneError(str(error).replace("--set ", f"{self.where}: [set] ")) from None
        return load_scene(path, [*words, *overrides])

    def _flat(self, section: str) -> dict[str, Any]:
        """The entries of [set] or [vary] by key; what names no key is refused."""
        entries = self.content.get(section, {})
        if not isinstance(entries, Mapping):
            self.refuse(f"{section} = {written(entries)}: must be a table, [{section}]")
            return {}
        flat: dict[str, Any] = {}
        for top, below in entries.items():
            if "." in top or not isinstance(below, Mapping):
                flat[top] = below
            else:
                flat |= {f"{top}.{name}": value for name, value in below.items()}
        for name in [name for name in flat if name not in self.known]:
            self.refuse(f"[{section}] {name}: is no key of a scene{nearest(name, list(self.known))}")
            del flat[name]
        return flat

    def _fixed(self) -> dict[str, Any]:
        fixed = self._flat("set")
        if isinstance(fixed.get("puff.file"), str) and fixed["puff.file"]:
            fixed["puff.file"] = self._beside(fixed["puff.file"])
        return fixed

    def _beside(self, path: str) -> str:
        return str((self.folder / path).absolute())

    def _design(self) -> tuple[str, int, int]:
        design = self.content.get("design")
        if not isinstance(design, Mapping):
            self.refuse('[design]: is missing; it says the kind, as in kind = "latin_hypercube"')
            return "grid", 0, 1
        kind = design.get("kind")
        if kind not in KINDS:
            allowed = " | ".join(f'"{name}"' for name in KINDS)
            self.refuse(f"[design] kind = {written(kind) if kind is not None else 'nothing'}: must be one of {allowed}")
            return "grid", 0, 1
        takes = KINDS[kind][1]
        for name in design:
            if name != "kind" and name not in takes:
                beside = ", ".join(takes) or "nothing"
                self.refuse(f"[design] {name}: a design of kind {kind} takes beside its kind {beside}")
        wanted = "base_samples" if kind == "sensitivity" else "eyes"
        eyes = design.get(wanted, 0)
        if wanted in takes and not (_whole(eyes) and 1 <= eyes <= EYES_MAX):
            self.refuse(f"[design] {wanted} = {written(eyes)}: must be a whole number from 1 to {EYES_MAX}")
            eyes = 1
        elif kind == "sensitivity" and (eyes < 2 or eyes & (eyes - 1)):
            self.refuse(f"[design] base_samples = {eyes}: must be a power of 2, as 256, 512, 1024")
        seed = design.get("seed", 1)
        if not (_whole(seed) and 0 <= seed < 2**32):
            self.refuse(f"[design] seed = {written(seed)}: must be a whole number from 0 to {2**32 - 1}")
            seed = 1
        return kind, int(eyes) if wanted in takes else 0, int(seed)

    def _show(self) -> tuple[str, ...]:
        show = self.content.get("show", list(SHOWN))
        if not isinstance(show, list) or not show:
            self.refuse(f"show = {written(show)}: must be an array of columns")
            return SHOWN
        for name in show:
            if name not in FIGURES:
                self.refuse(f"show: {written(name)} is no figure of the table{nearest(str(name), list(FIGURES))}")
        return tuple(str(name) for name in show)

    def laws(self, base: Scene) -> tuple[dict[str, Law], dict[str, Follower]]:
        """What [vary] says, by key."""
        own = base.values()
        vary: dict[str, Law] = {}
        followers: dict[str, Follower] = {}
        for name, entry in self._flat("vary").items():
            kind, spec = self.known[name]
            try:
                law = read_law(entry, kind, spec, own[name])
            except BadLaw as wrong:
                self.refuse(f"[vary] {name} = {_toml(entry)}: {wrong}")
                continue
            if isinstance(law, Follower):
                followers[name] = law
            else:
                if name == "puff.file":
                    law = Choice(tuple(self._beside(value) if value else value for value in law.values))
                vary[name] = law
        return vary, followers

    def _correlations(self, vary: Mapping[str, Law]) -> tuple[tuple[str, str, float], ...]:
        entries = self.content["design"].get("correlations", [])
        found: list[tuple[str, str, float]] = []
        if not isinstance(entries, list):
            self.refuse(f"[design] correlations = {written(entries)}: must be an array of [key, key, number]")
            return ()
        for entry in entries:
            if (
                not (isinstance(entry, list) and len(entry) == 3)
                or not isinstance(entry[2], int | float)
                or not -1.0 < entry[2] < 1.0
            ):
                self.refuse(f"[design] correlations: {_toml(entry)} must be [key, key, number above -1 and below 1]")
                continue
            unknown = [name for name in entry[:2] if name not in vary]
            if unknown or entry[0] == entry[1]:
                what = f"{unknown[0]} does not vary by a law" if unknown else "a key goes with itself"
                self.refuse(f"[design] correlations: {_toml(entry)}: {what}")
                continue
            if {entry[0], entry[1]} in [{a, b} for a, b, _ in found]:
                self.refuse(f"[design] correlations: {entry[0]} with {entry[1]} stands there twice")
                continue
            found.append((entry[0], entry[1], float(entry[2])))
        if found and np.linalg.eigvalsh(correlation_matrix(list(vary), found)).min() <= 1e-10:
            self.refuse("[design] correlations: contradict each other (their matrix is not positive definite)")
        return tuple(found)

    def _check(self, kind, vary, followers, table) -> None:
        if kind == "table":
            both = [name for name in vary]
            if both:
                self.refuse(f"[vary] {both[0]}: with a design from a table only what follows stands in [vary]")
        elif not vary:
            self.refuse("[vary]: nothing varies; name a key with its law, as in eye.iop_mmhg = { from = 10, to = 30 }")
        for name, law in vary.items():
            if kind in LEVELLED and law.levels is None:
                self.refuse(f"[vary] {name} = {_toml(law.plain())}: a {kind} needs levels: say steps, or values")
            if kind not in LEVELLED and law.plain().get("steps"):
                self.refuse(f"[vary] {name}: steps belong to a grid; a design of kind {kind} draws in between")
            if kind == "sensitivity" and isinstance(law, Choice):
                self.refuse(f"[vary] {name}: a sensitivity study needs keys that vary continuously")
        leaders = table if table is not None else vary
        for name, law in followers.items():
            if law.follows not in leaders or name in leaders:
                what = "varies itself" if name in leaders else f"{law.follows} does not vary"
                self.refuse(f"[vary] {name}: follows {law.follows}, but {what}")
            elif self.known[law.follows][0] is not float:
                self.refuse(f"[vary] {name}: follows {law.follows}, which is no number")

    def _file(self, base: Scene) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        named = self.content["design"].get("file")
        if not isinstance(named, str) or not named:
            self.refuse('[design] file: must name a CSV or Parquet file, as in file = "eyes.csv"')
            return {}, {}
        path = self.folder / named
        frame = read_eyes(path)
        columns: dict[str, np.ndarray] = {}
        labels: dict[str, np.ndarray] = {}
        for name in frame.columns:
            if "." not in name:
                labels[name] = frame[name].to_numpy(dtype=str)
            elif name not in self.known:
                self.problems.append(f"{path}: column {name} is no key of a scene{nearest(name, list(self.known))}")
            else:
                columns[name] = self._column(path, name, frame[name])
        taken = [name for name in labels if name == "eye" or name in FIGURES or name in ("status", "reason")]
        for name in taken:
            self.problems.append(f"{path}: column {name} is one of the study's own; name it otherwise")
        if not columns and not self.problems:
            self.problems.append(f'{path}: no column names a key of a scene, as "eye.iop_mmhg" does')
        if not len(frame):
            self.problems.append(f"{path}: has no rows")
        return columns, labels

    def _column(self, path: Path, name: str, cells) -> np.ndarray:
        kind, spec = self.known[name]
        values = []
        for row, cell in enumerate(cells):
            value = _cell(cell, kind)
            if value is None or not spec.holds(value):
                said = f"{kind.__name__}, {spec.bounds()}" if spec.bounds() else kind.__name__
                self.problems.append(f'{path}: row {row + 1}: {name} = "{cell}"; allowed is {said}')
                return np.zeros(len(cells))
            values.append(self._beside(value) if name == "puff.file" and value else value)
        return np.array(values, dtype=object if kind is str else None)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _cell(cell: Any, kind: type) -> Any:
    """A cell of a table as the key's type; None where it is none."""
    text = str(cell).strip()
    if kind is str:
        return text
    if kind is bool:
        return {"true": True, "false": False}.get(text.lower())
    value = number(text, ";")
    if not math.isfinite(value) or kind is int and value != int(value):
        return None
    return kind(value)


def read_eyes(path: Path):
    """A table of eyes as a data frame of strings; SceneError where it cannot be read."""
    import pandas

    if path.suffix.lower() == ".parquet":
        if not path.is_file():
            raise SceneError(f"{path}: no such file")
        try:
            return pandas.read_parquet(path).astype(str)
        except Exception as error:  # what a damaged file raises depends on where it is damaged
            raise SceneError(f"{path}: cannot be read ({(str(error).splitlines() or [''])[0][:120]})") from None
    keys = {name for name, _, _ in all_keys()}
    header, delimiter, rows = read_cells(path, keys.__contains__)
    for line, cells in rows:
        if len(cells) != len(header):
            raise SceneError(f"{path}: line {line} has {len(cells)} values, the header {len(header)}")
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise SceneError(f"{path}: the header names {twice} more than once")
    return pandas.DataFrame([cells for _, cells in rows], columns=header, dtype=str)


def correlation_matrix(names: Sequence[str], correlations: Sequence[tuple[str, str, float]]) -> np.ndarray:
    """The matrix of correlations, [names, names]."""
    matrix = np.eye(len(names))
    for a, b, value in correlations:
        matrix[names.index(a), names.index(b)] = matrix[names.index(b), names.index(a)] = value
    return matrix


def _count(study: Study) -> int:
    """Eyes of a study's design."""
    if study.table is not None:
        return len(next(iter(study.table.values())))
    if study.kind == "grid":
        return math.prod(len(law.levels) for law in study.vary.values())
    if study.kind == "one_at_a_time":
        return 1 + sum(len(law.levels) for law in study.vary.values())
    return study.eyes * (len(study.vary) + 2) if study.kind == "sensitivity" else study.eyes


def plain_scene(scene: Scene) -> dict[str, Any]:
    """The values of a scene that are not its defaults or computed, by key; `Scene.but` of the default eye makes it."""
    own = scene.values()
    return {
        name: own[name]
        for name, _, spec in all_keys()
        if (name in scene.given if spec.default == AUTO else own[name] != spec.default)
    }


def scene_of(values: Mapping[str, Any]) -> Scene:
    """The scene that `plain_scene` was taken of."""
    return load_scene().but(values)
