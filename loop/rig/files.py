"""Light as files in a folder, for a player of the user's own."""

import json
import os
from contextlib import suppress

import cv2
import numpy as np

from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import FilesLightParams
from luxloop.loop.rig.wire.ddp import Codes, codes_of
from luxloop.loop.rig.wire.screen import stacked
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole

PICTURE, ABOUT = "light.png", "light.json"


class FilesLight:
    """Each light replaces `light.png`, and then `light.json` with number and commands, both atomically."""

    def __init__(self, params: FilesLightParams) -> None:
        """Raises LuxloopError if the folder does not exist or cannot be written."""
        self._params, self._number, self._shape = params, -1, (1, 1)
        if not params.folder.is_dir() or not os.access(params.folder, os.W_OK):
            raise LuxloopError(f"light.folder: {params.folder} is no folder that can be written; make it")

    def show(self, shine: Shine) -> str | None:
        """Write new light; for current light touch `light.json`, which shows that the loop is alive. Returns the reason if it fails."""
        try:
            if shine.number == self._number:
                os.utime(self._params.folder / ABOUT)
            else:
                codes = stacked([codes_of(u, self._params.bits, self._params.gamma) for u in shine.pictures])
                self._write(codes, {"number": shine.number, "modules": [vars(each) for each in shine.commands]})
                self._number, self._shape = shine.number, codes.shape
        except (LuxloopError, OSError) as error:
            return f"light: {error}"
        return None

    def dark(self) -> None:
        """Write a black picture."""
        self._number = -1
        with suppress(LuxloopError):
            self._write(codes_of(np.zeros(self._shape), self._params.bits), {"number": None, "modules": []})

    def close(self) -> None:
        return None

    def _write(self, codes: Codes, about: dict[str, object]) -> None:
        done, coded = cv2.imencode(".png", codes, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        assert done
        with whole(self._params.folder / PICTURE) as part:
            part.write_bytes(coded.tobytes())
        with whole(self._params.folder / ABOUT) as part:
            part.write_text(json.dumps(about), "utf-8")
