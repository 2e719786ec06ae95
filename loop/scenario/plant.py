"""Plants by name, and sources of modules' light: the scenario's lamp, or a real lamp whose beam is digitised live (T 4.3)."""

from typing import Annotated, Literal

from pydantic import Field

from luxloop.world.params import Params
from luxloop.world.plugin import KnownOrOwn, OwnPart


class SimulatedPlantParams(Params):
    """The simulated world of the scenario."""

    kind: Literal["simulated"] = "simulated"


class RecordedPlantParams(Params):
    """The frames of a recording, on which perception and controllers run in shadow: their commands are not shown."""

    kind: Literal["recording"]
    folder: str = Field(min_length=1, examples=["runs/mine"], description="recording that `luxloop run --frames` wrote")


class RemotePlantParams(Params):
    """Another simulator, which connects to the loop and runs in lockstep (docs/programs.md)."""

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
    """A plant of the user's own, made by `Name(scenario, modules, **options)`."""


def shadow_of(plant: SimulatedPlantParams | RecordedPlantParams | RemotePlantParams | RigPlantParams | OwnPlantParams) -> str | None:
    """Folder of the recording on which the loop runs in shadow; None for a plant that shows light."""
    return plant.folder if isinstance(plant, RecordedPlantParams) else None


class ModuleSourceParams(Params):
    """Source of a module's light, by the module's name, or by the lamp's side for a lamp with a single module."""

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
        """Delay of the light, and of the body's motion if it is delayed as well, in control steps."""
        return round(self.latency_s * rate_hz)


PlantParams = Annotated[
    SimulatedPlantParams | RecordedPlantParams | RemotePlantParams | RigPlantParams | OwnPlantParams,
    KnownOrOwn("kind", "simulated"),
]
