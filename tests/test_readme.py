"""The README as a reader types it: every line of its shell blocks, one after another, in a folder of a reader's files.

Some five minutes, so only where the environment variable TAICHI_EYE_README is set. Lines that make a virtual
environment are run by .ci/run.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines() if line.strip() and "-m venv" not in line]
PUFF = re.search(r"(?:^    .*\n)+", README[README.index("A puff of your own") :], re.MULTILINE)[0]
# a film as a clinic has it: slit images alone, in the instrument's container
FILMED = ["corvis_healthy", "--set", "camera.view=scheimpflug", "--set", "numerics.fidelity=cavity", "--out", "made"]


@pytest.mark.skipif("TAICHI_EYE_README" not in os.environ, reason="some minutes: set TAICHI_EYE_README")
def test_every_line_runs_as_typed(tmp_path):
    environment = os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])),
    }

    def typed(line: str) -> None:
        done = subprocess.run(["bash", "-ec", line], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0 and "Traceback" not in done.stderr, f"{line}\n{done.stdout}{done.stderr}"

    (tmp_path / "configs").symlink_to(ROOT / "configs")
    (tmp_path / "my_puff.csv").write_text("".join(line[4:] for line in PUFF.splitlines(keepends=True)))
    typed("taichi-eye run --quiet " + " ".join(FILMED))
    film = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", tmp_path / "made" / "film.mp4", "-c", "copy"]
    subprocess.run([*film, tmp_path / "film.avi"], check=True)
    (tmp_path / "films").mkdir()
    for name in ("a.avi", "b.avi"):
        shutil.copy(tmp_path / "film.avi", tmp_path / "films" / name)
    assert len(LINES) >= 12
    for line in LINES:
        typed(line)
