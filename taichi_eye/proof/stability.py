"""`taichi-eye stability`: maps of where the methods work and fail, each with its theory drawn on the measurement."""

import json
import time
from pathlib import Path

import numpy as np

from taichi_eye.proof.maps.cloud import cloud
from taichi_eye.proof.maps.corners import corners
from taichi_eye.proof.maps.coupling import coupling
from taichi_eye.proof.maps.sound_speed import sound_speed
from taichi_eye.proof.maps.spectrum import spectrum
from taichi_eye.proof.maps.time_step import time_step
from taichi_eye.proof.maps.wall import wall
from taichi_eye.provenance import png_metadata
from taichi_eye.report.folder import create_run_folder, replacing, write_text
from taichi_eye.report.page import picture, plain, table, write_page

PARTS = {
    "spectrum": spectrum,
    "time-step": time_step,
    "coupling": coupling,
    "sound-speed": sound_speed,
    "wall": wall,
    "cloud": cloud,
    "corners": corners,
}


def report(
    only=(), out: str | None = None, json_file: str | None = None, say=lambda text: print(text, flush=True)
) -> bool:
    """Draw the maps named (all without names): a PNG each, one page, what was found in words.

    out: folder (default: a new one under renders/); json_file: the figures. Returns whether no run failed in silence: a
    run that went wrong without a stop, or stopped with the wrong diagnosis, makes it False.
    """
    folder = create_run_folder(out, "stability")
    parts, figures, broken = [], {}, []
    for name in only or PARTS:
        started = time.perf_counter()
        say(name)
        here = PARTS[name](say)
        for line in here.found + [f"FAILED IN SILENCE: {line}" for line in here.broken]:
            say(f"  {line}")
        say(f"  {name}: {time.perf_counter() - started:.0f} s")
        with replacing(folder / f"{name}.png") as temporary:
            here.canvas.savefig(temporary, format="png", facecolor="white", metadata=png_metadata())
        theory = __import__(PARTS[name].__module__, fromlist=["x"]).__doc__ or ""
        parts += [f"<h2>{name}</h2>", "<ul>" + "".join(f"<li>{plain(line)}</li>" for line in here.found) + "</ul>"]
        if here.broken:
            parts.append("<p class=no>" + "<br>".join(plain(line) for line in here.broken) + "</p>")
        parts += [picture(here.canvas), f"<pre>{plain(theory)}</pre>"]
        if here.body:
            parts.append(table(here.head, here.body))
        figures[name] = {"found": here.found, "failed_in_silence": here.broken, **here.figures}
        broken += [f"{name}: {line}" for line in here.broken]
        # after every map: an interrupted study keeps what it has
        write_page(folder / "stability.html", "taichi-eye stability", [_verdict(broken), *parts], markdown=True)
        if json_file:
            write_text(Path(json_file), json.dumps(figures, indent=2, default=_number) + "\n")
    say(_verdict(broken).replace("<p>", "").replace("</p>", ""))
    say(str(folder / "stability.html"))
    return not broken


def _verdict(broken: list[str]) -> str:
    return (
        "<p>Every failing corner ended in a stop with its diagnosis.</p>"
        if not broken
        else f"<p>{len(broken)} corners failed in silence or with the wrong diagnosis.</p>"
    )


def _number(value):
    """What json does not know: numpy's numbers and arrays."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)
