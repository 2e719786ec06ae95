"""The video of a run: the camera's annotated frames, or what people see, at its own rate."""

from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

from luxloop.loop.recording.video import NOISY_CRF, VideoWriter
from luxloop.loop.report.onlooker import Onlooker, first_oncoming
from luxloop.loop.report.picture import frame_picture, white_of
from luxloop.loop.report.views import above, chase, driver, oncoming
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.result import mean_lights
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.eye import exposure_of
from luxloop.world.errors import locate

CAMERA_HZ = 10  # slower than most loops, so that single steps are visible
CLEAN_CRF = 20
ROUNDING_S = 1e-9
VIEWS = {"driver": driver, "chase": chase, "above": above, "oncoming": oncoming}


class Film(VideoWriter):
    """A video of the scenario's `video.view`."""

    def __init__(self, path: Path, simulation: Simulation) -> None:
        """Raises LuxloopError where the file cannot be written, or the plant does not know what people see."""
        scenario, self._simulation = simulation.scenario, simulation
        self._onlooker: Onlooker | None = None
        self._white: Tensor | None = None
        self._before: tuple[float, Sequence[Tensor]] | None = None
        wanted = scenario.video
        size, rate_hz = (scenario.camera.width_px, scenario.camera.height_px), float(CAMERA_HZ)
        if wanted.view != "camera":
            view, rate_hz = VIEWS[wanted.view](wanted.width_px), wanted.rate_hz
            size = view.width, view.height
            with locate(f"video.view = {wanted.view!r}"):
                rides = first_oncoming(simulation) if wanted.view == "oncoming" else None
                self._onlooker = Onlooker.of(simulation, view, with_car=wanted.view != "driver", rides=rides)
        self._exposure_ev, self._rate_hz, self._frames = wanted.exposure_ev, rate_hz, 0
        super().__init__(path, rate_hz, size, NOISY_CRF if self._onlooker is None else CLEAN_CRF)

    def step(self, result: Evaluation) -> None:
        """Add a step: one frame of the camera, or all frames since the step before, each with the light of the nearer step."""
        if self._onlooker is None:
            self._white = white_of(result, self._simulation) if self._white is None else self._white
            self.add(frame_picture(result, self._simulation, self._white))
            return
        time_s, commands = result.time_s, result.now.commands
        lights = mean_lights(result, self._simulation.scenario.shares)
        if self._exposure_ev is None:
            self._exposure_ev = exposure_of(self._onlooker.light(time_s, lights, commands))
        before_s, earlier = self._before or (time_s, lights)
        while (now_s := self._frames / self._rate_hz) <= time_s + ROUNDING_S:
            nearer = earlier if now_s - before_s < time_s - now_s else lights  # a mixture would show symbols twice
            self.add(self._onlooker.picture(now_s, nearer, commands, self._exposure_ev))
            self._frames += 1
        self._before = time_s, lights
