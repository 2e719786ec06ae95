"""Plants by name, and where the light of modules comes from: the scenario's lamp, or a real one whose beam is digitised live (T 4.3)."""

from typing import Annotated, Literal

from pydantic import Field

from luxloop.world.params import Params
from luxloop.world.plugin import KnownOrOwn, OwnPart


class SimulatedPlantParams(Params):
    """The simulated world of the scenario."""

    kind: Literal["simulated"] = "simulated"


class RecordedPlantParams(Params):
    """The frames of a recording, which show the light of that run; perception and controller step on them in shadow."""

    kind: Literal["recording"]
    folder: str = Field(min_length=1, examples=["runs/mine"], description="recording that `luxloop run --frames` wrote")


class RemotePlantParams(Params):
    """Another simulator, which connects to the loop and runs in lockstep with it (docs/programs.md)."""

    kind: Literal["remote"]
    address: str = Field(
        "127.0.0.1:4060",
        pattern=r"^([A-Za-z0-9.-]+|\[[0-9a-f:]+\]):[1-9]\d{0,4}$",
        description="where the loop waits for the simulator: an address of this machine, and a port",
    )
    sends: Literal["utilisation", "texture"] = Field(
        "utilisation", description="light that the simulator gets: utilisation of each pixel, or light texture of each module in cd"
    )
    timeout_s: float = Field(30.0, ge=0.01, le=3600, description="longest wait for the simulator to connect, and for each of its answers")


class RigPlantParams(Params):
    """A lamp and a camera of a laboratory, whose addresses are in the rig file of `luxloop run --rig FILE`; see docs/rig.md."""

    kind: Literal["rig"]


class OwnPlantParams(OwnPart):
    """`Name(scenario, modules, **options)` of a module of the user's own makes the plant."""


def shadow_of(plant: SimulatedPlantParams | RecordedPlantParams | RemotePlantParams | RigPlantParams | OwnPlantParams) -> str | None:
    """The recording that is played, None where light is shown."""
    return plant.folder if isinstance(plant, RecordedPlantParams) else None


class ModuleSourceParams(Params):
    """One module of the lamps, by its name, or its lamp's side where that has a single one."""

    source: Literal["simulated", "digitised"] = Field(
        "simulated", description="simulated, or digitised from a picture of a real lamp's light on a screen; needs `--rig FILE`"
    )
    latency_s: float = Field(
        0.0, ge=0, le=10, description="delay of digitised light in the simulated world; at 0 the world waits for the light"
    )
    delay_body: bool = Field(
        False, description="whether the motion of the vehicle's body on its springs is delayed by latency_s, so that it matches the light"
    )

    def late_steps(self, rate_hz: float) -> int:
        """Control steps, rate_hz of them a second, by which its light is late, and its body as well where that is delayed."""
        return round(self.latency_s * rate_hz)


PlantParams = Annotated[
    SimulatedPlantParams | RecordedPlantParams | RemotePlantParams | RigPlantParams | OwnPlantParams,
    KnownOrOwn("kind", "simulated"),
]
