"""The packages that studies need and a single run does not: the extras `studies` and `cluster`."""

from importlib.util import find_spec

from taichi_eye.errors import SceneError

STUDIES = {"pandas": "pandas", "pyarrow": "pyarrow", "SALib": "SALib"}  # module -> distribution
CLUSTER = {"distributed": "distributed"}


def refuse_missing(cluster: bool = False) -> None:
    """SceneError where a package is missing, with the command that installs it."""
    wanted, extra = (STUDIES | CLUSTER, "studies,cluster") if cluster else (STUDIES, "studies")
    missing = [distribution for module, distribution in wanted.items() if find_spec(module) is None]
    if missing:
        are = "is" if len(missing) == 1 else "are"
        raise SceneError(
            f"{', '.join(missing)} {are} not installed, which {'studies on a cluster' if cluster else 'studies'} need: "
            f"pip install 'taichi-eye[{extra}]'"
        )
