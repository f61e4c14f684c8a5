"""What a run would take, estimated from its scene before any work: memory, and the pixels of its film.

Memory in bytes, each term measured on runs that are large in it alone:

    a process with its kernels, of earlier runs, too            600 MB
    nodes of the liquid            8 kB each, and 40 B for each node and wall node where a flow map is kept
    slit image                     30 B a pixel, the images on their way to the encoder among them
    particle view, or both         75 B a pixel of the frame, six of the sheet among them
    samples                        1 kB each
    the wall at every film frame   100 B for each frame and wall node

The numbers of nodes are upper bounds: the half section of the chamber lies within limbus radius times depth.
"""

import math

from taichi_eye.scene.draft import Draft

MEMORY_MAX = 3e9  # bytes
PIXELS_MAX = 1e12  # of a whole film: some hours of drawing
SAMPLE_MS = 0.025  # longest time between two rows of the traces
PANEL_ASPECT = 320 / 1152  # of the particle view, which is twice as wide as the slit image


def frame_pixels(draft: Draft) -> float:
    """Pixels of a frame of the film."""
    width, height = draft["camera.width_px"], draft["camera.height_px"]
    panel = PANEL_ASPECT * (2 * width) ** 2
    return {"scheimpflug": width * height, "particles": panel, "both": panel + 4 * width * height}[draft["camera.view"]]


def memory(draft: Draft) -> dict[tuple[str, ...], float]:
    """Bytes that a run takes at its largest, by the keys that ask for them."""
    spacing, limbus, radius = (
        draft[name] for name in ("numerics.spacing_mm", "cornea.limbus_radius_mm", "cornea.radius_mm")
    )
    walls = radius * math.asin(limbus / radius) / spacing + 1
    nodes = limbus * draft["chamber.depth_mm"] / spacing**2
    duration, interval, frames = (
        draft[name] for name in ("numerics.duration_ms", "camera.frame_interval_ms", "camera.frame_count")
    )
    mapped = draft["numerics.fidelity"] == "added_mass"
    image = ("camera.width_px", "camera.height_px", "camera.view")
    return {
        (): 600e6,
        ("numerics.spacing_mm", "numerics.fidelity"): nodes * (8e3 + 40 * walls * mapped),
        image: 30 * draft["camera.width_px"] * draft["camera.height_px"]
        + 75 * frame_pixels(draft) * (draft["camera.view"] != "scheimpflug"),
        ("numerics.duration_ms", "camera.frame_interval_ms"): 1e3 * duration * (1 / SAMPLE_MS + 1 / interval),
        ("camera.frame_count", "numerics.spacing_mm"): 100 * frames * walls,
    }


def refuse_costly(draft: Draft) -> None:
    """Record a problem where a run would take more memory, or draw more pixels, than is reasonable."""
    terms = memory(draft)
    if sum(terms.values()) > MEMORY_MAX:
        most = max(terms, key=terms.get)
        draft.refuse(
            f"the run would take some {sum(terms.values()) / 1e9:.3g} GB of memory, {terms[most] / 1e9:.3g} GB of it "
            f"for this; at most {MEMORY_MAX / 1e9:g} GB",
            *most,
        )
    pixels = frame_pixels(draft) * draft["camera.frame_count"]
    if pixels > PIXELS_MAX:
        draft.refuse(
            f"the film would have {pixels:.3g} pixels in all; at most {PIXELS_MAX:.3g}",
            "camera.frame_count",
            "camera.width_px",
            "camera.height_px",
            "camera.view",
        )
