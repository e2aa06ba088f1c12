"""Masks by a model that takes boxes as prompts (SAM and its variants), as two ONNX files.

The image encoder runs once for each image. The other file holds the prompt encoder and the mask
decoder; it runs once for each box. Published exports have the same prompts. Other inputs and
outputs differ, and are read from the files:

- SAM, MobileSAM (github.com/ChaoningZhang/MobileSAM, scripts/export_onnx_model.py) and NanoSAM:
  `image_embeddings` and prompts with `mask_input`, `has_mask_input`, in some exports also
  `orig_im_size` → `low_res_masks`, `iou_predictions`.
- EfficientViT-SAM (github.com/mit-han-lab/efficientvit, applications/efficientvit_sam): prompts of
  points alone → `masks` (not enlarged), `iou_predictions`; points are in a frame of 1024 px, though
  the image encoder takes 512 px.
- SAM 2 (github.com/vietanhdev/samexporter): three features, `image_embed` and two finer ones; the
  image is stretched to a square, not padded.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from edge import config
from edge.perception.masks.segmenter import Deadline, rasterise
from edge.perception.runtime.card_types import SegmentCard
from edge.perception.runtime.cards import ModelError, load_card_of, verify_model
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.onnx_file import MASK_OUTPUTS, PROMPTS
from edge.perception.runtime.sessions import DTYPES, open_onnxruntime_session, raise_as_model_error
from edge.types import MASK_SIDE

_BOX_LABELS = np.array([[2.0, 3.0]], np.float32)
"""SAM's labels of a box's upper left and lower right corner."""


class SamSegmenter:
    """A segmenter (`Segmenter`) that runs an image encoder and a mask decoder.

    All buffers are allocated once, except onnxruntime's outputs.

    Raises:
        ModelError: card, files or providers are unusable, or the two files do not match.
    """

    def __init__(self, settings: config.SegmenterOnnx) -> None:
        self.card = card = load_card_of(SegmentCard, settings.model)
        self.name = card.name
        prompts = {"point_coords": ((1, 2, 2),) * 3, "point_labels": ((1, 2),) * 3}
        self._encoder, self._decoder = (
            open_onnxruntime_session(
                verify_model(part, believe_cache=True), settings.providers, settings.threads,
                settings.device_id,
                EngineOptions(card.name, card.precision, shapes, section="perception.segmenter"),
            )
            for part, shapes in zip(card.files, ({}, prompts), strict=True)
        )  # fmt: skip
        self._pixel_input = self._encoder.get_inputs()[0].name
        self._features = self._match_features()
        # Inputs of the decoder other than the features, by name; `segment` changes the points.
        self._prompt = {
            value.name: np.zeros([n if isinstance(n, int) else 1 for n in value.shape],
                                 DTYPES[value.type])
            for value in self._decoder.get_inputs() if value.name in PROMPTS
        }  # fmt: skip
        self._prompt["point_coords"] = np.zeros((1, 2, 2), np.float32)
        self._prompt["point_labels"] = _BOX_LABELS.astype(self._prompt["point_labels"].dtype)
        decoder_outputs = {value.name for value in self._decoder.get_outputs()}
        self._mask_output = next(name for name in MASK_OUTPUTS if name in decoder_outputs)
        self._pixels = np.zeros((1, 3, card.input.height, card.input.width), np.float32)
        std = np.array(card.preprocess.std, np.float32)
        self._gain = np.float32(card.preprocess.scale) / std
        self._offset = -np.array(card.preprocess.mean, np.float32) / std
        with raise_as_model_error(f"model {self.name}: it fails at its first image"):
            box = np.array([[0, 0, 32, 32]], np.float32)
            out = np.zeros((1, MASK_SIDE, MASK_SIDE), np.bool_)
            self.segment(np.zeros((32, 32, 3), np.uint8), box, out, Deadline(None))

    def segment(
        self, rgb: np.ndarray, boxes: np.ndarray, out: np.ndarray, deadline: Deadline
    ) -> int:
        """Make masks of the boxes until the deadline; return the number of boxes done.

        See `Segmenter.segment`.

        Raises:
            ModelError: a mask is not finite.
        """
        if not len(boxes):
            return 0
        scale = self._fill_pixels(rgb)
        with _abort_at(deadline) as options:
            features = _run(self._encoder, None, {self._pixel_input: self._pixels}, options)
            if features is None:
                return 0
            by_name = dict(
                zip((v.name for v in self._encoder.get_outputs()), features, strict=True)
            )
            feed = {name: by_name[output] for name, output in self._features.items()} | self._prompt
            if "orig_im_size" in feed:
                feed["orig_im_size"][:] = rgb.shape[:2]
            outputs = [self._mask_output, "iou_predictions"]
            for i, box in enumerate(boxes):
                self._prompt["point_coords"][:] = box.reshape(1, 2, 2) * scale
                found = _run(self._decoder, outputs, feed, options)
                if found is None:
                    return i
                self._write_best_mask(*found, scale, box, out[i])
        return len(boxes)

    def close(self) -> None:
        """Release the sessions; do not call `segment` afterwards."""
        self._encoder = self._decoder = None

    def _match_features(self) -> dict[str, str]:
        """Map each feature input of the decoder to an output of the encoder.

        Inputs and outputs match by name. If there is one of each, their names do not matter.
        """
        outputs = [value.name for value in self._encoder.get_outputs()]
        inputs = [v.name for v in self._decoder.get_inputs() if v.name not in PROMPTS]
        if inputs and set(inputs) <= set(outputs):
            return dict(zip(inputs, inputs, strict=True))
        if len(inputs) == len(outputs) == 1:
            return {inputs[0]: outputs[0]}
        encoder, decoder = self.card.files
        raise ModelError(
            f"{decoder.file}: needs the inputs {', '.join(inputs) or 'none'}, but {encoder.file} "
            f"makes {', '.join(outputs)}: take both files from one export"
        )

    def _fill_pixels(self, rgb: np.ndarray) -> np.ndarray:
        """Write the image into the encoder's input.

        Returns:
            (2,) scale from image pixels to the decoder's points, in x and y. The points are in a
            square with the side `card.prompt_px`.
        """
        height, width = rgb.shape[:2]
        rows, columns = self._pixels.shape[2:]
        if self.card.fit == "pad":
            shrink = min(rows / height, columns / width)
            h, w = max(1, round(height * shrink)), max(1, round(width * shrink))
        else:
            h, w = rows, columns
        scaled = cv2.resize(rgb, (w, h), interpolation=cv2.INTER_LINEAR)
        self._pixels[:, :, h:] = 0.0
        self._pixels[:, :, :, w:] = 0.0
        for channel in range(3):
            plane = self._pixels[0, channel, :h, :w]
            np.multiply(scaled[:, :, channel], self._gain[channel], out=plane)
            plane += self._offset[channel]
        across = self.card.prompt_px / columns * w / width
        down = self.card.prompt_px / rows * h / height
        return np.array([across, down], np.float32)

    def _write_best_mask(
        self, logits: np.ndarray, iou: np.ndarray, scale: np.ndarray, box: np.ndarray,
        out: np.ndarray,
    ) -> None:  # fmt: skip
        """Write the mask with the highest predicted IoU; the decoder returns several for a box.

        Args:
            logits: (1, k, rows, columns), k masks over the decoder's square.
            iou: (1, k), predicted IoU of each mask.
            scale: see `_fill_pixels`.
            box: (4,) xyxy in pixels of the image.
            out: (MASK_SIDE, MASK_SIDE) bool out.
        """
        best = np.ascontiguousarray(logits[0, int(np.argmax(iou[0]))], np.float32)
        if not np.isfinite(best).all():
            raise ModelError(f"{self.name}: masks are not finite: export the model again")
        rows, columns = best.shape
        to_mask = np.array([columns, rows], np.float32) / self.card.prompt_px
        rasterise(best, (0.0, 0.0), tuple(scale * to_mask), box, out)


@contextlib.contextmanager
def _abort_at(deadline: Deadline) -> Iterator[Any]:
    """Yield onnxruntime options that abort a run at the deadline."""
    import onnxruntime as ort

    options, left_s = ort.RunOptions(), deadline.left_s()
    if math.isinf(left_s):
        yield options
        return
    options.terminate = left_s <= 0.0
    timer = threading.Timer(max(0.0, left_s), setattr, (options, "terminate", True))
    timer.daemon = True
    timer.start()
    try:
        yield options
    finally:
        timer.cancel()


def _run(
    session: Any, outputs: Sequence[str] | None, feed: Mapping[str, np.ndarray], options: Any
) -> list[np.ndarray] | None:
    """Run the session; return None if the deadline passed before it finished."""
    if options.terminate:
        return None
    try:
        return session.run(outputs, feed, options)
    except Exception:  # onnxruntime raises many types
        if options.terminate:
            return None
        raise
