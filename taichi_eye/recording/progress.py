"""The bar on the terminal."""

from __future__ import annotations

from tqdm import tqdm

from taichi_eye.recording.observer import Observer


class Progress(Observer):
    """Shows how far the run is; there from before the simulation is set up, so that its compiling is seen, too."""

    def __init__(self, duration_ms: float, shown: bool):
        self._bar = tqdm(
            total=duration_ms,
            unit=" ms",
            disable=not shown,
            dynamic_ncols=True,
            bar_format="{desc}{percentage:3.0f}%|{bar}| {n:.1f}/{total:g} ms [{elapsed}<{remaining}]",
        )
        self._bar.set_description_str("compiling kernels: ")

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind, error, trace) -> None:
        self._bar.close()

    def decided(self, choice) -> None:
        """Say what "auto" has chosen (`taichi_eye.ladder.choose`), and how long that will take, before it does."""
        if not self._bar.disable:
            self._bar.write(f"auto     {choice.reason}; some {choice.expected_s:.1g} s")
            for doubt in choice.doubts:
                self._bar.write(f"warning: {doubt}")

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        if not self._bar.disable:
            self._bar.write(_announce(recording.scene, recording.simulation))
        self.show("air puff: ", recording.simulation.time_ms)

    def show(self, what: str, time_ms: float) -> None:
        """What is computed now, and how far."""
        if self._bar.desc != what:
            self._bar.set_description_str(what)
        self._bar.update(min(time_ms, self._bar.total) - self._bar.n)

    def sample(self) -> None:
        self.show("air puff: ", self.recording.simulation.time_ms)

    def closed(self, ending) -> None:
        if ending.stop is None:
            self._bar.update(self._bar.total - self._bar.n)
        self._bar.close()


def _announce(scene, simulation) -> str:
    return (
        f"cornea   {simulation.wall_count - 1} elements, R {scene.cornea.radius_mm:g} mm, limbus "
        f"{scene.cornea.limbus_radius_mm:g} mm, {scene.cornea.thickness_mm:g} mm thick, IOP "
        f"{scene.eye.iop_mmhg:g} mmHg\n"
        f"aqueous  {scene.numerics.fidelity}: {simulation.about()}\n"
        f"puff     {scene.puff.time_course}, {float(simulation.puff.peak) / 1e3:g} kPa"
    )
