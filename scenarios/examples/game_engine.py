"""A game engine as the plant of a loop: `python game_engine.py [ADDRESS]` plays one run after another, until Ctrl-C.

    luxloop run flat --set plant.kind=remote plant.sends=texture camera.bits=8 camera.gamma=2.2 camera.width_px=640 camera.height_px=360

It drives a car along a road of its own, whose body pitches, past a pedestrian, and renders what its camera sees in colour, with pyrender.
The light textures that it gets are projected onto the road, as an engine's projector textures are. docs/programs.md describes the messages.
It needs no luxloop: only numpy, pyrender, trimesh and websockets.
"""

import json
import os
import struct
import sys
import time

import numpy as np

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("PYGLET_HEADLESS", "true")
import pyrender
import trimesh
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

SPEED_M_S, PITCH_RAD, PITCH_HZ = 8.0, 0.004, 1.2
ALBEDO, PAINT, AMBIENT_LX = 0.1, 0.4, 1.0
X_M, Y_M = np.arange(6, 46, 0.05), np.arange(5, -5, -0.0125)  # of the road's texels, from the car: far ones are seen at a grazing angle
GROUND = np.stack(np.broadcast_arrays(X_M[:, None], Y_M, 0.0, 1.0), -1)
WALKER_M = np.array([40.0, -3.0, 0.9])  # in the world


def pose(pitch: float = 0.0, position: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Of something that is turned nose down."""
    c, s = np.cos(pitch), np.sin(pitch)
    return np.array([[c, 0, s, position[0]], [0, 1, 0, position[1]], [-s, 0, c, position[2]], [0, 0, 0, 1]])


class Engine:
    """The world of a run. welcome: what the loop has told of lamps and camera."""

    def __init__(self, welcome: dict) -> None:
        self.modules, self.camera, self.time_s = welcome["modules"], welcome["camera"], 0.0
        self.renderer = pyrender.OffscreenRenderer(self.camera["width"], self.camera["height"])

    def arrivals(self, head: dict, arrays: list[np.ndarray]) -> tuple[dict, dict[str, np.ndarray]]:
        """The answer to a message, with what comes by the end of an exposure: its frame, samples of sensors and objects."""
        answer, frames = {"type": "arrivals", "number": head["number"], "frames": []}, {}
        if head["type"] == "start":
            self.time_s = 0.0
        else:
            frames[f"frame.{head['number']}"] = self.render(head, arrays)
            taken_s, self.time_s = self.time_s, self.time_s + head["duration_s"]
            answer["frames"] = [{"number": head["number"], "taken_s": taken_s, "arrived_s": self.time_s}]
        pitch, rate = self.pitch()
        values = {"wheels": [SPEED_M_S], "gyro": [0.0, rate, 0.0], "attitude": [0.0, 0.0, pitch, 0.0, 0.0, 0.0, 0.0, 0.0]}
        samples = [{"sensor": each, "measured_s": self.time_s, "arrived_s": self.time_s, "values": v} for each, v in values.items()]
        foot = pose(position=(WALKER_M[0] - SPEED_M_S * self.time_s, WALKER_M[1], 0.0)).ravel().tolist()
        walker = {"name": "walker", "category": "pedestrian", "T_ground_object": foot, "size_m": [0.5, 0.5, 1.8]}
        return answer | {"time_s": self.time_s, "samples": samples, "objects": [walker]}, frames

    def pitch(self) -> tuple[float, float]:
        """Of the body, and its rate."""
        phase, rate = 2 * np.pi * PITCH_HZ * self.time_s, 2 * np.pi * PITCH_HZ
        return PITCH_RAD * np.sin(phase), rate * PITCH_RAD * np.cos(phase)

    def render(self, head: dict, arrays: list[np.ndarray]) -> np.ndarray:
        """Digital numbers of the camera `[height, width]`."""
        T_ground_body, way_m = pose(self.pitch()[0]), SPEED_M_S * self.time_s
        lights = list(zip(self.modules, head["windows"], arrays, strict=True))
        painted = (np.abs(np.abs(GROUND[..., 1]) - 1.75) < 0.06) & ((GROUND[..., 0] + way_m) % 9 < 3)
        road = self.code(np.where(painted, PAINT, ALBEDO), sum(lux(GROUND, (0, 0, 1), T_ground_body, *each) for each in lights))
        image = pyrender.Texture(source=np.repeat(road[..., None], 3, -1), source_channels="RGB")
        x, y = (X_M[0] - 0.025, X_M[-1] + 0.025), (Y_M[0] + 0.00625, Y_M[-1] - 0.00625)
        quad = pyrender.Primitive(
            np.array([[x[0], y[0], 0], [x[0], y[1], 0], [x[1], y[1], 0], [x[1], y[0], 0]]),
            indices=[[0, 1, 2], [0, 2, 3]],
            texcoord_0=np.array([[0, 1], [1, 1], [1, 0], [0, 0]]),  # columns go to the right, rows ahead; the first row has v = 1
            material=pyrender.MetallicRoughnessMaterial(baseColorTexture=image),
        )
        scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 1.0])
        scene.add(pyrender.Mesh([quad]))
        box, middle = trimesh.creation.box((0.5, 0.5, 1.8)), WALKER_M - [way_m, 0, 0]
        lx = sum(lux(np.append(middle, 1.0), (-1, 0, 0), T_ground_body, *each) for each in lights)
        box.visual.vertex_colors = [*[int(self.code(0.3, lx))] * 3, 255]
        scene.add(pyrender.Mesh.from_trimesh(box, smooth=False), pose=pose(position=middle))
        optics = pyrender.IntrinsicsCamera(*(self.camera[name] for name in ("fx", "fy", "cx", "cy")), znear=0.3, zfar=200.0)
        T_body_camera = np.reshape(self.camera["T_body_camera"], (4, 4))
        scene.add(optics, pose=T_ground_body @ T_body_camera @ np.diag([1.0, -1.0, -1.0, 1.0]))  # OpenGL looks along -z, with y up
        return self.renderer.render(scene, pyrender.RenderFlags.FLAT)[0][..., 0]

    def code(self, albedo: np.ndarray | float, lx: np.ndarray) -> np.ndarray:
        """Digital numbers of a matt surface."""
        share = albedo / np.pi * (lx + AMBIENT_LX) / self.camera["saturation_cd_m2"]
        return np.round(255 * np.minimum(share, 1) ** (1 / self.camera["gamma"])).astype(np.uint8)


def lux(points: np.ndarray, normal: tuple, T_ground_body: np.ndarray, module: dict, window: list, light: np.ndarray) -> np.ndarray:
    """Illuminance of points `[..., 4]` from a module whose light texture is 0 beyond its window. Modules that turn stay at rest here."""
    T_module = T_ground_body @ np.reshape(module["T_body_module"], (4, 4))
    ray = points @ np.linalg.inv(T_module).T
    (top, bottom, left, right), (rows, cols) = window, (module["rows"], module["cols"])
    row = (module["top"] - ray[..., 2] / ray[..., 0]) / (module["top"] - module["bottom"]) * rows
    col = (module["left"] - ray[..., 1] / ray[..., 0]) / (module["left"] - module["right"]) * cols
    inside = (ray[..., 0] > 0) & (row >= top) & (row < bottom) & (col >= left) & (col < right)
    lx = np.zeros(np.shape(inside))
    away = T_module[:3, 3] - points[inside][..., :3]
    distance = np.linalg.norm(away, axis=-1)
    cd = light[row[inside].astype(int) - top, col[inside].astype(int) - left]
    lx[inside] = cd * np.maximum(away @ np.array(normal), 0) / distance**3
    return lx


def unpacked(data: bytes) -> tuple[dict, list[np.ndarray]]:
    """Head and arrays of a message of the loop, whose arrays are all raw."""
    (length,) = struct.unpack_from("<I", data)
    head, body = json.loads(data[4 : 4 + length]), data[4 + length :]
    parts = head.get("arrays", {}).values()
    return head, [np.frombuffer(body, f"<{e['dtype']}", e["bytes"] // int(e["dtype"][1]), e["start"]).reshape(e["shape"]) for e in parts]


def packed(head: dict, frames: dict[str, np.ndarray]) -> bytes:
    """A message of ours, with at most one frame."""
    told = {"dtype": "u1", "start": 0, "coding": "raw"}
    listed = {name: told | {"shape": each.shape, "bytes": each.nbytes} for name, each in frames.items()}
    text = json.dumps(head | {"arrays": listed}).encode()
    return struct.pack("<I", len(text)) + text + b"".join(each.tobytes() for each in frames.values())


def play(socket: ClientConnection) -> None:
    """One run, to its end."""
    socket.send(packed({"type": "hello", "protocol": 1, "name": "game engine"}, {}))
    for data in socket:
        head, arrays = unpacked(data)
        if head["type"] == "welcome":
            engine = Engine(head)
            if head["sends"] != "texture" or head["camera"]["bits"] != 8:
                socket.send(packed({"type": "error", "text": "needs plant.sends=texture and camera.bits=8"}, {}))
        elif head["type"] in ("start", "show"):
            socket.send(packed(*engine.arrivals(head, arrays)))
        else:
            print(head.get("text", "the run is over"), flush=True)


def main(address: str = "ws://127.0.0.1:4060") -> None:
    """Wait for runs, and play them."""
    while True:
        try:
            with connect(address, max_size=None, compression=None, proxy=None) as socket:
                play(socket)
        except (OSError, WebSocketException):
            time.sleep(0.2)


if __name__ == "__main__":
    main(*sys.argv[1:2])
