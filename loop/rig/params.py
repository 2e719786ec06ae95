"""The rig file: addresses, devices and limits of one laboratory."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from luxloop.world.errors import locate
from luxloop.world.params import Params, Positive, PositiveShare
from luxloop.world.plugin import KnownOrOwn, OwnPart, beside, refuse_code
from luxloop.world.validation import read_toml, validate_model

Port = Annotated[int, Field(ge=1, le=65535)]
Host = Annotated[str, Field(min_length=1, max_length=255)]
Count = Annotated[int, Field(ge=1, le=100_000)]
EXAMPLE = "docs/rig.md has a complete file"


class ScanParams(Params):
    """Order of the pixels on the network or the screen."""

    columns_first: bool = Field(False, description="whether pixels are ordered column by column, not row by row")
    from_right: bool = Field(False, description="whether rows start at the right")
    from_bottom: bool = Field(False, description="whether columns start at the bottom")
    serpentine: bool = Field(False, description="whether every second row (or column) runs backwards")


class LightParams(Params):
    """Keys of all light devices."""

    gamma: float = Field(1.0, ge=0.2, le=5, description="a code is the utilisation to the power of 1/gamma; 1 is a linear lamp")
    keep_alive_s: float = Field(0.03, ge=0.005, le=1, description="interval at which the current light is repeated")
    dark_after_s: float = Field(0.1, ge=0.02, le=60, description="the lamp's own time-out: time without data until the lamp is dark")

    @model_validator(mode="after")
    def _alive(self) -> Self:
        if self.keep_alive_s > self.dark_after_s / 2:
            raise ValueError(
                f"keep_alive_s: {self.keep_alive_s:g} s is more than half of dark_after_s, {self.dark_after_s:g} s; the lamp would flicker"
            )
        return self


class DdpLightParams(LightParams):
    """A lamp on the network, with DDP over UDP."""

    kind: Literal["ddp"]
    host: Host = Field(examples=["192.168.1.20"], description="name or address of the lamp")
    port: Port = Field(4048, description="UDP port")
    bits: Literal[8, 16] = Field(8, description="bits of a code")
    repeats: int = Field(1, ge=1, le=8, description="number of times that new light is sent, against lost packets")
    commands: bool = Field(True, description="whether orientation and maximum intensity of the modules are sent")
    timecode: bool = Field(
        False, description="whether packets carry their frame's number as time code, with which the rig process repairs incomplete frames"
    )
    scan: ScanParams = Field(ScanParams(), description="order of the pixels")


class ScreenLightParams(LightParams):
    """A page in full screen on a second display or a projector."""

    kind: Literal["screen"]
    host: Host = Field("127.0.0.1", description="address to listen on")
    port: Annotated[int, Field(ge=0, le=65535)] = Field(8766, description="port to listen on, 0 for a free one")
    scan: ScanParams = Field(ScanParams(), description="how the picture is mirrored")


class FilesLightParams(LightParams):
    """A folder of PNG files for a user's own player."""

    kind: Literal["files"]
    folder: Path = Field(examples=["light"], description="folder for light.png, and light.json with its number and commands")
    bits: Literal[8, 16] = Field(8, description="bits of a code")


class OwnLightParams(OwnPart, LightParams):
    """`Name(**options)` of a user's own module."""


Lights = Annotated[DdpLightParams | ScreenLightParams | FilesLightParams | OwnLightParams, KnownOrOwn("kind")]


class CropParams(Params):
    """A rectangle of the camera's picture."""

    u_px: int = Field(0, ge=0, le=65535, description="first column")
    v_px: int = Field(0, ge=0, le=65535, description="first row")
    width_px: int = Field(ge=1, le=8192, description="columns", examples=[640])
    height_px: int = Field(ge=1, le=8192, description="rows", examples=[480])


class CameraSourceParams(Params):
    """Keys of all cameras."""

    timeout_s: float = Field(1.0, gt=0, le=60, description="time without a picture until the lamp is darkened and the camera reconnected")
    crop: CropParams | None = Field(
        None, description="part of the picture that is the scenario's image, only without a calibration; left out: the whole picture"
    )
    bits: int | None = Field(None, ge=8, le=16, description="bits of a digital number; left out: 8 or 16, as in the picture")


class HttpCameraParams(CameraSourceParams):
    """A network camera that sends JPEG or PNG pictures in one endless answer (MJPEG)."""

    kind: Literal["http"]
    url: str = Field(pattern="^http://", examples=["http://192.168.1.21:8080/camera"], description="address of the camera")
    largest_bytes: int = Field(16_000_000, ge=1000, le=200_000_000, description="largest size of a picture in bytes")


class DeviceCameraParams(CameraSourceParams):
    """A V4L2 device, by OpenCV."""

    kind: Literal["device"]
    device: str = Field("/dev/video0", description="device file")
    width_px: int = Field(640, ge=16, le=8192, description="columns to request")
    height_px: int = Field(480, ge=16, le=8192, description="rows to request")
    rate_hz: float = Field(30.0, gt=0, le=1000, description="frame rate to request")
    fourcc: str | None = Field(
        None,
        pattern="^[A-Za-z0-9 ]{4}$",
        examples=["MJPG"],
        description="pixel format to request; many webcams reach high rates of large pictures with MJPG only; left out: the driver's",
    )
    exposure: float | None = Field(
        None, description="exposure to lock, in the driver's unit (100 us with most webcams); left out: unchanged"
    )
    gain: float | None = Field(None, description="gain to lock, in the driver's unit; left out: unchanged")


class StreamCameraParams(CameraSourceParams):
    """An RTSP or other video stream, by PyAV."""

    kind: Literal["stream"]
    url: str = Field(min_length=1, examples=["rtsp://192.168.1.21/live"], description="address of the stream")
    options: dict[str, str] = Field(
        {"rtsp_transport": "tcp", "fflags": "nobuffer", "flags": "low_delay"}, description="options of FFmpeg's demuxer"
    )


class FolderCameraParams(CameraSourceParams):
    """A folder into which another program writes whole pictures, with names in ascending order."""

    kind: Literal["folder"]
    folder: Path = Field(examples=["frames"], description="folder of PNG, JPEG or TIFF files")


class OwnCameraParams(OwnPart, CameraSourceParams):
    """`Name(**options)` of a user's own module."""

    triggered: bool = Field(False, description="whether each frame is triggered, by the method trigger")


Cameras = Annotated[
    HttpCameraParams | DeviceCameraParams | StreamCameraParams | FolderCameraParams | OwnCameraParams,
    KnownOrOwn("kind"),
]


class NoEgoParams(Params):
    """A standing vehicle."""

    kind: Literal["none"] = "none"


class UdpEgoParams(Params):
    """Samples of the vehicle's sensors as UDP datagrams of JSON."""

    kind: Literal["udp"]
    host: Host = Field("127.0.0.1", description="address to listen on")
    port: Port = Field(4049, description="UDP port to listen on")
    latency_s: float = Field(0.0, ge=0, le=10, description="time from sending a sample to its arrival")


class OwnEgoParams(OwnPart):
    """`Name(**options)` of a user's own module."""


Egos = Annotated[NoEgoParams | UdpEgoParams | OwnEgoParams, KnownOrOwn("kind", "none")]


class LimitParams(Params):
    """Limits of the lamp's light."""

    power: PositiveShare = Field(1.0, description="largest mean utilisation of all pixels; brighter light is dimmed")
    power_w: float | None = Field(None, gt=0, le=1e6, description="largest power in W; needs full_w")
    full_w: float | None = Field(None, gt=0, le=1e6, description="power in W with all pixels on")
    change_per_s: Positive = Field(
        1000.0, description="largest change of the mean utilisation per second; a faster change is spread over several exposures"
    )
    loop_s: float = Field(1.0, ge=0.1, le=60, description="time without a sign of life from the loop until the lamp is darkened")

    @model_validator(mode="after")
    def _both(self) -> Self:
        if self.power_w is not None and self.full_w is None:
            raise ValueError("power_w needs full_w, the power of all pixels on")
        return self

    @property
    def share(self) -> float:
        """Largest mean utilisation by both limits."""
        return self.power if self.power_w is None or self.full_w is None else min(self.power, self.power_w / self.full_w)


class TimingParams(Params):
    """Times from light to frame, as measured by `luxloop rig blink`."""

    latency_s: float = Field(
        0.1, ge=0, le=5, description="mean time from sending light to the arrival of a frame whose exposure begins together with the light"
    )
    jitter_s: float = Field(
        0.03, ge=0, le=5, description="largest lateness of a frame beyond latency_s: the measured worst case with a margin"
    )
    rolling_s: float = Field(0.035, ge=0, le=5, description="time from the start of the first row's exposure to the end of the last row's")
    wait_s: float = Field(1.0, gt=0, le=60, description="time from sending light until its frame counts as lost")

    @model_validator(mode="after")
    def _patient(self) -> Self:
        if self.wait_s <= self.clear_s:
            raise ValueError(
                f"wait_s: {self.wait_s:g} s is no longer than latency_s + jitter_s = {self.clear_s:g} s; no frame would ever count"
            )
        return self

    @property
    def clear_s(self) -> float:
        """Least time from sending light to the arrival of a frame that shows no earlier light."""
        return self.latency_s + self.jitter_s


class MarkParams(Params):
    """A mark in the light: four cells side by side that identify one of four exposures."""

    module: int = Field(0, ge=0, le=1000, description="number of the module that shows the mark")
    row: int = Field(0, ge=0, le=100_000, description="first row of pixels")
    column: int = Field(0, ge=0, le=100_000, description="first column of pixels")
    rows: Count = Field(16, description="height in pixels")
    columns: Count = Field(64, description="width of all four cells in pixels")
    u_px: float = Field(ge=0, le=8192, description="left border in the scenario's image", examples=[10])
    v_px: float = Field(ge=0, le=8192, description="upper border in the scenario's image", examples=[10])
    width_px: float = Field(gt=0, le=8192, description="width of all four cells in the image", examples=[80])
    height_px: float = Field(gt=0, le=8192, description="height in the image", examples=[20])
    contrast: float = Field(
        0.2, gt=0, lt=1, description="least contrast of a bright and a dark cell, difference over sum; a frame with less is lost"
    )


class RigCalibrationParams(Params):
    """Result of `luxloop rig calibrate`."""

    file: Path = Field(examples=["rig.npz"], description="calibration file, for rectifying the camera's pictures and digitising beams")


class PlatformParams(Params):
    """A motion platform, to which the pose of the vehicle's body is sent at each exposure of a live digitised beam."""

    host: Host = Field(examples=["192.168.1.30"], description="name or address of the platform")
    port: Port = Field(4050, description="UDP port")


class RigParams(Params):
    """A rig: the devices of one laboratory."""

    light: Lights = Field(description="the lamp")
    camera: Cameras = Field(description="the camera")
    ego: Egos = Field(NoEgoParams(), description="the vehicle's sensors")
    limits: LimitParams = Field(LimitParams(), description="limits of the light")
    timing: TimingParams = Field(TimingParams(), description="times from light to frame")
    mark: MarkParams | None = Field(None, description="a mark in the light that identifies a frame's exposure")
    calibration: RigCalibrationParams | None = Field(None, description="the camera's calibration")
    platform: PlatformParams | None = Field(None, description="a motion platform")

    @property
    def has_trigger(self) -> bool:
        """Whether each frame of the camera is triggered."""
        return isinstance(self.camera, OwnCameraParams) and self.camera.triggered


def load_rig(file: Path, *, allow_code: bool = False) -> RigParams:
    """Read a rig file; its paths are relative to the file. Opens no device.

    allow_code: whether Python modules named in the file may run. Raises LuxloopError with file, key and remedy.
    """
    data = read_toml(file)
    with locate(str(file)):
        for table in data.values():
            if isinstance(table, dict):
                table |= {key: _resolve(key, value, file.parent) for key, value in table.items()}
        rig = validate_model(RigParams, data, EXAMPLE)
    if not allow_code:
        refuse_code(rig, str(file))
    return rig


def _resolve(key: str, value: Any, folder: Path) -> Any:
    """Value of a table's key, with a path or module resolved from the file's folder."""
    if isinstance(value, str) and key in ("file", "folder"):
        return str(folder / Path(value).expanduser())
    return beside(value, folder) if isinstance(value, str) and key == "kind" else value
