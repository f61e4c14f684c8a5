"""A resolved scene, and how to change one.

A scene remembers which of its computed keys were given and computes the others from the rest. `Scene.but` is the way
from one scene to another: it goes through the checks and computations of a scene file, so that what is computed follows
what it depends on, and what contradicts is refused. `dataclasses.replace` on a section keeps what was computed for the
old values: a new IOP on the old prestrain, a new sound speed under the old mean pressure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from taichi_eye.scene.draft import CHANGE, FILE, Draft
from taichi_eye.scene.resolve import resolve
from taichi_eye.scene.schema import AUTO, SECTIONS, Sections, all_keys, keys_of


@dataclass(frozen=True)
class Scene(Sections):
    """A resolved scene: one attribute per section, each with one attribute per key, all values filled in.

    given: those of the keys with a computed default, as "section.key", that were given and not computed. Two scenes
    with the same values are equal, whichever of them were given.
    """

    given: frozenset[str] = field(default=frozenset(), compare=False, repr=False)

    @classmethod
    def of(cls, draft: Draft) -> Scene:
        """The scene that a draft makes, defaults and computed keys filled in; SceneError with every problem found."""
        draft.stop_if_refused()
        for name, _, spec in all_keys():
            draft.values.setdefault(name, spec.default)
        given = frozenset(name for name, _, spec in all_keys() if spec.computed and draft.given(name))
        resolve(draft)
        return cls(
            **{
                section: build(**{name: draft[f"{section}.{name}"] for name in keys_of(section)})
                for section, build in SECTIONS.items()
            },
            given=given,
        )

    def values(self) -> dict[str, Any]:
        """Every value by "section.key", in the order of the table."""
        return {
            f"{section}.{name}": getattr(getattr(self, section), name)
            for section in SECTIONS
            for name in keys_of(section)
        }

    def but(self, changes: Mapping[str, Any], within_limits: bool = True) -> Scene:
        """This scene with other values: `scene.but({"eye.iop_mmhg": 20, "cornea.prestrain": "auto"})`.

        changes: by "section.key", a value or, where it is to be computed, "auto". Keys computed here are computed anew;
        keys given here are kept, and SceneError says what contradicts. within_limits: False lets a study of what fails
        take values beyond the limits of their keys, and a spacing beyond those of the chamber.
        """
        draft = Draft("scene", "changes", within_limits)
        own = self.values()
        for name, _, spec in all_keys():
            computed = spec.computed and name not in self.given
            draft.values[name] = AUTO if computed else own[name]
            if not computed and own[name] != spec.default:
                draft.origin[name] = FILE
        for name, value in changes.items():
            draft.put(name, value, CHANGE)
        return Scene.of(draft)
