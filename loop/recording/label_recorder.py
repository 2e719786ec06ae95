"""Writes labels beside the frames that a recording keeps."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from luxloop.loop.recording import coco, kitti
from luxloop.loop.recording.frames import FrameRecorder
from luxloop.loop.recording.label_files import CALIB, COCO, FOLDER, IMAGE_2, IMAGES, LABEL_2, frame_name, light_name, mask_name, values_name
from luxloop.loop.recording.labelled import LabelledImage, Labels, part_names
from luxloop.loop.simulation.frames import QUICK
from luxloop.loop.simulation.protocol import Exposure, Showing
from luxloop.loop.simulation.world import World
from luxloop.world.arrays import write_npz
from luxloop.world.files import link, whole


class LabelRecorder:
    """Labels the frames of a run; `add` what was shown in a step, `write` the table of all now and then."""

    def __init__(self, directory: Path, world: World, labels: Labels, frames: FrameRecorder) -> None:
        """frames: which keeps the frames that are labelled, and is given each step before."""
        self._directory, self._world, self._labels, self._frames = directory, world, labels, frames
        self._parts = part_names(world)
        self._waiting: dict[int, Exposure] = {}  # for their frames
        self._images: list[str] = []
        self._annotations: list[str] = []

    def begin(self) -> None:
        """Make the folders. Raises OSError where that cannot be."""
        for name in (FOLDER, *((IMAGE_2, LABEL_2, CALIB) if self._labels.layout == "kitti" else ())):
            (self._directory / name).mkdir(exist_ok=True)

    def add(self, showings: Sequence[Showing]) -> None:
        """Label the frames that have come, each with what was true when it was exposed. Raises LuxloopError where that cannot be."""
        for showing in showings:
            self._waiting[showing.exposure.number] = showing.exposure
            for frame in showing.after.frames:
                exposure = self._waiting.get(frame.number)
                self._waiting = {number: each for number, each in self._waiting.items() if number > frame.number}
                if exposure is not None and frame.image is not None:
                    shown = replace(frame.shown or exposure, number=frame.number)
                    self._keep(LabelledImage.of(self._world, shown, self._labels, self._parts))

    def write(self) -> None:
        """Write what is known of all images, whole or not at all. Raises LuxloopError where that cannot be."""
        names = {"instances": self._world.instances, "parts": ("", *self._parts)}
        head: coco.Entry = {"camera": coco.camera(self._world.view), **names}
        lists, file = {"images": self._images}, IMAGES
        if self._labels.layout == "coco":
            head["categories"] = coco.categories()
            lists, file = {**lists, "annotations": self._annotations}, COCO
        with whole(self._directory / file) as part:
            part.write_text(coco.document(head, lists), "utf-8")

    def _keep(self, labelled: LabelledImage) -> None:
        number = labelled.number
        files = {"file_name": frame_name(number), "light": light_name(self._frames.light_of(number))}
        if labelled.parts is not None:
            files |= {"instances": mask_name("instances", number), "parts": mask_name("parts", number)}
            self._write_mask(files["instances"], labelled.instances)
            self._write_mask(files["parts"], labelled.parts)
        for kind, values in (("depth", labelled.depth), ("lux", labelled.lux)):
            if values is not None:
                files[kind] = values_name(kind, number)
                with whole(self._directory / files[kind]) as part:
                    write_npz(part, [(kind, values)])
        self._images.append(json.dumps(coco.image(labelled, files)))
        if self._labels.layout == "kitti":
            self._write_kitti(labelled)
        else:
            self._annotations += map(json.dumps, coco.annotations(labelled, len(self._annotations) + 1))

    def _write_mask(self, name: str, mask: np.ndarray) -> None:
        with whole(self._directory / name) as part:
            part.write_bytes(cv2.imencode(".png", mask, QUICK)[1].tobytes())

    def _write_kitti(self, labelled: LabelledImage) -> None:
        name = f"{labelled.number:06d}"
        with whole(self._directory / IMAGE_2 / f"{name}.png") as part:
            link(self._directory / frame_name(labelled.number), part)
        for folder, text in ((LABEL_2, kitti.lines(labelled)), (CALIB, kitti.calibration(self._world.view))):
            with whole(self._directory / folder / f"{name}.txt") as part:
                part.write_text(text)
