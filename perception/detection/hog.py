"""OpenCV's people detector: histograms of gradients and a linear SVM (Dalal & Triggs 2005), with OpenCV's weights."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.perception.detection.coded import encode
from luxloop.perception.detection.params import HogParams
from luxloop.perception.detection.protocol import Detections
from luxloop.perception.detection.suppression import suppress
from luxloop.world.traffic.tracked import Category

SHRINK = (0.55, 0.75)  # of its window of 64 x 128 px, in whose middle a person of 96 px stands


class HogDetector:
    """See `Detector`. A score is the logistic function of the distance to the classifier's plane."""

    classes: tuple[Category, ...] = ("pedestrian",)

    def __init__(self, params: HogParams) -> None:
        self.params = params
        self._hog = cv2.HOGDescriptor()
        self._hog.setSVMDetector(np.asarray(cv2.HOGDescriptor.getDefaultPeopleDetector()))

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """See `Detector`."""
        return [self._found(frame) for frame in frames]

    def _found(self, frame: Tensor) -> Detections:
        params = self.params
        picture = cv2.resize(encode(frame, params.gamma), None, fx=params.magnify, fy=params.magnify, interpolation=cv2.INTER_LINEAR)
        # OpenCV reads beyond images that are smaller than its window
        width, height = self._hog.winSize
        below, right = max(height - picture.shape[0], 0), max(width - picture.shape[1], 0)
        picture = cv2.copyMakeBorder(picture, 0, below, 0, right, cv2.BORDER_REPLICATE)
        margin = math.log(params.threshold / (1 - params.threshold)) / params.slope
        windows, margins = self._hog.detectMultiScale(picture, hitThreshold=margin, winStride=(8, 8), scale=1.05, groupThreshold=0)
        corner, size = torch.from_numpy(np.reshape(windows, (-1, 4)).astype(np.float32) / params.magnify).split(2, 1)
        half = size * torch.tensor(SHRINK) / 2
        boxes = torch.cat([corner + size / 2 - half, corner + size / 2 + half], 1)
        scores = torch.sigmoid(params.slope * torch.from_numpy(np.ravel(margins).astype(np.float32)))
        order = scores.argsort(descending=True)
        boxes, scores = boxes[order].to(frame.device), scores[order, None].to(frame.device)
        kept = ~suppress(boxes, params.overlap) if len(boxes) else slice(0)
        return Detections(boxes[kept], scores[kept])
