"""The packages that live pages need and a run does not: the extra `page`."""

from importlib.util import find_spec

from taichi_eye.errors import SceneError

PAGE = {"starlette": "starlette", "uvicorn": "uvicorn", "websockets": "websockets"}  # module -> distribution


def refuse_missing() -> None:
    """SceneError where a package is missing, with the command that installs it."""
    missing = [distribution for module, distribution in PAGE.items() if find_spec(module) is None]
    if missing:
        are = "is" if len(missing) == 1 else "are"
        raise SceneError(
            f"{', '.join(missing)} {are} not installed, which live pages need: pip install 'taichi-eye[page]'"
        )
