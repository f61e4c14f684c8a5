"""Scene files: the schema, loading with validation, and writing a resolved scene."""

from taichi_eye.scene.load import dump_scene, load_scene
from taichi_eye.scene.scene import Scene

__all__ = ["Scene", "dump_scene", "load_scene"]
