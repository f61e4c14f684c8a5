"""Another eye of a scene's kind: the same tissue and globe at another pressure and thickness."""

from __future__ import annotations

from taichi_eye.scene.scene import Scene


def eye_at(scene: Scene, iop_mmhg: float, thickness_um: float) -> Scene:
    """The scene's eye at another pressure and central thickness, the rim's along with the centre's.

    A globe's compliance falls as one over its pressure (Friedenwald): a linear one is taken at each pressure anew, one
    after Friedenwald follows by itself.
    """
    cornea, was, own = scene.cornea, scene.eye.iop_mmhg, scene.values()
    thicker = 1e-3 * thickness_um - cornea.thickness_mm
    changes = {
        "eye.iop_mmhg": iop_mmhg,
        "cornea.thickness_mm": cornea.thickness_mm + thicker,
        "cornea.limbus_thickness_mm": cornea.limbus_thickness_mm + thicker,
    }
    if own["chamber.globe_law"] == "linear":
        changes["chamber.compliance_mm3_mmhg"] = scene.chamber.compliance_mm3_mmhg * was / iop_mmhg
    return scene.but({name: value for name, value in changes.items() if value != own[name]})
