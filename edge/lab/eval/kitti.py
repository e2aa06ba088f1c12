"""Reads frames of SemanticKITTI (Behley et al., ICCV 2019), OpenNav's outdoor scenes (section IV).

A folder is one sequence in the layout of KITTI's odometry benchmark: `image_2/`, `velodyne/`,
`labels/`, `calib.txt`, `poses.txt`, `times.txt`, and `Tr_velo_to_cam0.txt` if `calib.txt` has no
`Tr`. The origin of `map` is on the road under the LiDAR at the first pose, x forward.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from edge.errors import UserError
from edge.geometry import FARTHEST_M, CameraModel, invert
from edge.host.c_stderr import silence_c_stderr
from edge.host.files import read_regular
from edge.tasks.scene.frames import plausible_points
from edge.tasks.scene.objects import clusters, downsample, overlap_share
from edge.tasks.scene.pipeline import PerceptionPipeline
from edge.tasks.scene.projection import in_picture
from edge.tasks.scene.scene import Scene
from edge.tasks.scene.scene_builder import OUTDOORS, SceneBuilder
from edge.types import MASK_SIDE, Detections, Observation

LIDAR_HEIGHT_M = 1.73
"""Height over the road, as KITTI's authors give it."""
CAR_RADIUS_M = 1.0
"""Half the car's width. A circle is enough, as no trajectory here turns on the spot."""

GROUND = {40: "road", 60: "road", 44: "parking", 48: "sidewalk", 49: "ground", 72: "terrain"}
"""Label → kind of ground. 49 is "other-ground", 60 lane markings; terrain may be grass."""
GROUND_LABELS = tuple(dict.fromkeys(GROUND.values()))
OBJECT_NAMES = {
    10: "car", 11: "bicycle", 13: "bus", 15: "motorcycle", 16: "train", 18: "truck",
    20: "vehicle", 30: "person", 31: "cyclist", 32: "motorcyclist", 50: "building", 51: "fence",
    52: "structure", 70: "bush", 71: "tree trunk", 80: "pole", 81: "traffic sign", 99: "object",
    252: "car", 253: "cyclist", 254: "person", 255: "motorcyclist", 256: "train", 257: "bus",
    258: "truck", 259: "vehicle",
}  # fmt: skip
"""Label → name of its objects."""
MOVING = 250
"""First label of moving objects."""
PLANT, TRUNK = 70, 71
"""Labels of vegetation and of tree trunks."""
TREE_M = 3.0
"""Vegetation is a tree if it is this high or over a trunk: a scan of a near tree ends low."""
REACH_M = {50: 1.5, 51: 1.0, 70: 0.8}
"""Label → gap that separates two of its objects if their instances are not known."""
REACH_ELSE_M = 0.6
"""The same gap for other labels."""
MIN_POINTS = 12
"""An object with fewer points is ignored."""
MIN_PX = 6
"""An object whose bounding box in the picture has a smaller side is ignored."""
_SKEW = 0.01
"""Tolerance for a rotation matrix, whose numbers are rounded in the file."""
_GAP_PX = 5, 9
"""Width and height of the gaps between neighbouring returns of one surface in the picture.

Scan lines are above each other, so the gaps are higher than wide.
"""


class KittiError(UserError):
    """A sequence that cannot be used; the message has the file and the problem."""


@dataclass(frozen=True, slots=True, eq=False)
class KittiFrame:
    """One instant of a sequence.

    Attributes:
        observation: image, cloud and pose; `seq` is the frame's number.
        semantic: (n,) uint16, label of each point of the cloud; 0: not labelled.
        instance: (n,) uint16, number of the object within its label; 0: no instance known.
    """

    observation: Observation
    semantic: np.ndarray
    instance: np.ndarray

    @property
    def ground_kind(self) -> np.ndarray:
        """(n,) uint8: index into `GROUND_LABELS` plus 1; 0: not ground."""
        table = np.zeros(1 << 16, np.uint8)
        for label, name in GROUND.items():
            table[label] = GROUND_LABELS.index(name) + 1
        return table[self.semantic]


def frames_in(folder: Path, labelled: bool = True) -> list[int]:
    """Return the numbers of the frames with image, scan and (if `labelled`) labels, ascending.

    Raises:
        KittiError: there are none.
    """
    kinds = [("image_2", "png"), ("velodyne", "bin")]
    if labelled:
        kinds.append(("labels", "label"))
    found = [
        {int(path.stem) for path in (folder / kind).glob(f"*.{ext}") if path.stem.isdigit()}
        for kind, ext in kinds
    ]
    numbers = sorted(set.intersection(*found))
    if not numbers:
        wanted = "image_2/, velodyne/ and labels/" if labelled else "image_2/ and velodyne/"
        raise KittiError(
            f"{folder}: no frame with {wanted}; give the folder of a SemanticKITTI sequence"
        )
    return numbers


def read_frame(folder: Path, number: int, labelled: bool = True) -> KittiFrame:
    """Read a frame with its camera, scan, labels and pose.

    Without `labelled`, the labels are not read and may be missing.

    Raises:
        KittiError: a file is missing or invalid.
    """
    calibration = _matrices(folder / "calib.txt")
    separate = folder / "Tr_velo_to_cam0.txt"
    if "Tr" not in calibration and separate.is_file():
        calibration |= _matrices(separate)
    for key in ("P2", "Tr"):
        if key not in calibration:
            raise KittiError(f"{folder / 'calib.txt'}: expected a line `{key}:` with 12 numbers")
    poses, times = _table(folder / "poses.txt", 12), _table(folder / "times.txt", 1)
    if not 0 <= number < min(len(poses), len(times)):
        raise KittiError(
            f"{folder}: no pose or time of frame {number}: poses.txt and times.txt end at frame "
            f"{min(len(poses), len(times)) - 1}"
        )
    path = folder / "image_2" / f"{number:06d}.png"
    png = np.frombuffer(_bytes(path), np.uint8)
    with silence_c_stderr():
        bgr = cv2.imdecode(png, cv2.IMREAD_COLOR) if len(png) else None
    if bgr is None:
        raise KittiError(f"{path}: not a readable image; fetch the file again")
    scan = _array(folder / "velodyne" / f"{number:06d}.bin", np.float32, 4).reshape(-1, 4)
    label = np.zeros(len(scan), np.uint32)
    if labelled:
        label = _array(folder / "labels" / f"{number:06d}.label", np.uint32, 1)
    if len(scan) != len(label):
        raise KittiError(
            f"{folder}: frame {number}: {len(scan)} points but {len(label)} labels; fetch both "
            "files again"
        )
    plausible = plausible_points(scan[:, :3])
    scan, label = scan[plausible], label[plausible]
    P2 = calibration["P2"]
    height, width = bgr.shape[:2]
    try:
        camera = CameraModel(width, height, P2[0, 0], P2[1, 1], P2[0, 2], P2[1, 2])
        offset_m = np.linalg.solve(P2[:, :3], P2[:, 3])  # P2 = K [I | t]
    except ValueError as error:  # includes a matrix without an inverse
        raise KittiError(
            f"{folder / 'calib.txt'}: P2 does not fit {path.name} ({width}x{height} px): {error}"
        ) from None
    # cam0 and cam2 are the sequence's cameras; cam2 took the images of `image_2`.
    T_cam0_velo = _rigid(calibration["Tr"], folder / "calib.txt: Tr")
    T_cam2_cam0 = np.eye(4)
    T_cam2_cam0[:3, 3] = offset_m
    T_base_velo = np.eye(4)
    T_base_velo[2, 3] = LIDAR_HEIGHT_M
    T_base_cam0 = T_base_velo @ invert(T_cam0_velo)
    # A pose in the file takes points of cam0 to the first frame's cam0. T_map_base is the same
    # motion, of the base.
    T_first_cam0 = _rigid(poses[number].reshape(3, 4), f"{folder / 'poses.txt'}: line {number + 1}")
    observation = Observation(
        seq=number,
        stamp_ns=round(1e9 * float(times[number, 0])),
        T_map_base=T_base_cam0 @ T_first_cam0 @ invert(T_base_cam0),
        rgb=cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB),
        camera=camera,
        T_base_camera=T_base_cam0 @ invert(T_cam2_cam0),
        cloud_m=np.ascontiguousarray(scan[:, :3]),
        T_base_lidar=T_base_velo,
    )
    # The lower half of a label is the class, the upper half the instance.
    return KittiFrame(
        observation, (label & 0xFFFF).astype(np.uint16), (label >> 16).astype(np.uint16)
    )


def objects_in(frame: KittiFrame) -> list[tuple[str, np.ndarray]]:
    """Return each labelled object: its name and its points, as indices into the cloud."""
    cloud = frame.observation.cloud_m
    trunks = cloud[frame.semantic == TRUNK]
    found = []
    for label, name in OBJECT_NAMES.items():
        for instance in np.unique(frame.instance[frame.semantic == label]):
            labelled = np.flatnonzero((frame.semantic == label) & (frame.instance == instance))
            reach_m = REACH_M.get(label, REACH_ELSE_M)
            # Points without an instance may belong to several objects: group them by distance.
            groups = (
                clusters(cloud[labelled], reach_m) if instance == 0 else [np.arange(len(labelled))]
            )
            for group in groups:
                points = labelled[group]
                if len(points) < MIN_POINTS:
                    continue
                is_tree = label == PLANT and _is_tree(cloud[points], trunks)
                found.append(("tree" if is_tree else name, points))
    return found


def _is_tree(plant_m: np.ndarray, trunks_m: np.ndarray) -> bool:
    """Return True if vegetation is high, or over a trunk."""
    is_high = float(np.ptp(plant_m[:, 2])) >= TREE_M
    flat = np.array([1.0, 1.0, 0.0], np.float32)  # sets z to 0
    return is_high or overlap_share(downsample(trunks_m) * flat, downsample(plant_m) * flat) > 0.0


def solid_m(frames: Sequence[KittiFrame]) -> np.ndarray:
    """Return the points of labelled objects that a robot would hit: (n, 2) float64 in `map`.

    Their height over the nearest ground is within the obstacle limits of `OUTDOORS`. Moving objects
    are skipped: another frame shows them elsewhere.
    """
    # By label: True for objects that do not move.
    is_solid = np.isin(np.arange(1 << 16), [label for label in OBJECT_NAMES if label < MOVING])
    ground, solid = [np.empty((0, 3))], [np.empty((0, 3))]
    for frame in frames:
        points_m = cloud_in_map(frame.observation)
        ground.append(
            downsample(points_m[frame.ground_kind > 0].astype(np.float32)).astype(np.float64)
        )
        solid.append(points_m[is_solid[frame.semantic]])
    floor_m, found_m = np.concatenate(ground), np.concatenate(solid)
    if not len(floor_m):
        return found_m[:, :2]
    _, nearest = cKDTree(floor_m[:, :2]).query(found_m[:, :2])
    height_m = found_m[:, 2] - floor_m[nearest, 2]
    low_m, high_m = OUTDOORS.obstacle_min_m, OUTDOORS.obstacle_max_m
    return found_m[(height_m >= low_m) & (height_m <= high_m), :2]


def cloud_in_map(seen: Observation) -> np.ndarray:
    """Return the points of the cloud in `map`, (n, 3) float64."""
    T = seen.T_map_base @ seen.T_base_lidar
    return seen.cloud_m @ T[:3, :3].T + T[:3, 3]


def label_pipeline(frames: Sequence[KittiFrame]) -> PerceptionPipeline:
    """Return a detection pipeline that takes boxes and masks from the frames' labels."""
    by_seq = {frame.observation.seq: frame for frame in frames}

    def boxes(observation: Observation, tags: Sequence[str]) -> Detections:
        return true_boxes(by_seq[observation.seq])

    # The boxes come with masks, so the last step changes nothing.
    words = tuple(dict.fromkeys((*OBJECT_NAMES.values(), "tree")))
    return PerceptionPipeline(lambda observation: words, boxes, lambda found: found)


def objects_shown(frame: KittiFrame) -> list[tuple[str, np.ndarray]]:
    """Return the objects in the picture: name, and those points that the picture shows.

    A building next to the robot may be known only by its far end.
    """
    return [(name, points) for name, points, _, _ in _in_picture(frame)]


def _in_picture(frame: KittiFrame) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (name, k points in the picture, their (k, 2) pixels, their bounding box)."""
    seen = frame.observation
    T = invert(seen.T_base_camera) @ seen.T_base_lidar
    at_px, shown = in_picture(seen.cloud_m, T, seen.camera)  # pixel of each point; bool
    for name, points in objects_in(frame):
        points = points[shown[points]]
        pixels = at_px[points]
        if len(pixels) < MIN_POINTS:
            continue
        box = np.concatenate((np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0) + 1e-3)))
        if min(box[2:] - box[:2]) >= MIN_PX:
            yield name, points, pixels, box


def true_boxes(frame: KittiFrame) -> Detections:
    """Return the labelled objects in the picture as detections, with masks from their returns."""
    seen = frame.observation
    boxes, names, masks = [], [], []
    for name, _, pixels, box in _in_picture(frame):
        boxes.append(box)
        names.append(name)
        masks.append(_mask(pixels, box))
    prompts = tuple(dict.fromkeys(names))
    n = len(boxes)
    return Detections(
        seen, np.array(boxes, np.float32).reshape(n, 4), np.ones(n, np.float32),
        np.array([prompts.index(name) for name in names], np.int32), prompts, model="labels",
        mask=np.array(masks, np.bool_).reshape(n, MASK_SIDE, MASK_SIDE),
    )  # fmt: skip


def scene_of(
    frames: Sequence[KittiFrame],
    pipeline: PerceptionPipeline | None = None,
    radius_m: float = CAR_RADIUS_M,
) -> Scene:
    """Build the scene of some frames, at the time of the last.

    The objects come from `pipeline`, and the regions are ground that is flat and connected. Without
    a pipeline, objects and kinds of ground come from the labels.
    """
    by_labels = pipeline is None
    pipeline = label_pipeline(frames) if pipeline is None else pipeline
    builder = SceneBuilder(pipeline, OUTDOORS, radius_m, GROUND_LABELS if by_labels else ())
    for frame in frames:
        builder.add(frame.observation, frame.ground_kind if by_labels else None)
    return builder.scene()


def _mask(pixels: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return (MASK_SIDE, MASK_SIDE) bool: the area between an object's returns in its box."""
    width, height = (box[2:] - box[:2]).astype(int)
    picture = np.zeros((height, width), np.uint8)
    x, y = (pixels - box[:2]).astype(int).T
    picture[y, x] = 255
    closed = cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones(_GAP_PX[::-1], np.uint8))
    small = cv2.resize(closed, (MASK_SIDE, MASK_SIDE), interpolation=cv2.INTER_AREA)
    enlarged = cv2.resize(closed, (MASK_SIDE, MASK_SIDE), interpolation=cv2.INTER_NEAREST)
    # At least 38 % (96 of 255) of a cell must be covered.
    return (small if width * height > MASK_SIDE**2 else enlarged) >= 96


def _rigid(rows: np.ndarray, where: object) -> np.ndarray:
    """Return the (4, 4) transform of the first three rows."""
    T = np.eye(4)
    T[:3] = rows
    R = T[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        is_rotation = np.allclose(R @ R.T, np.eye(3), atol=_SKEW) and np.linalg.det(R) > 0.0
    if not (is_rotation and np.abs(T[:3, 3]).max() <= FARTHEST_M):
        raise KittiError(
            f"{where}: expected a rotation matrix, and a translation of at most "
            f"{FARTHEST_M / 1000:g} km"
        )
    return T


def _bytes(path: Path) -> bytes:
    """Read a file of the sequence."""
    try:
        return read_regular(path)
    except OSError as error:
        raise KittiError(
            f"{path}: cannot be read: {error.strerror or error}; give the folder of a "
            "SemanticKITTI sequence"
        ) from None


def _array(path: Path, dtype: type, columns: int) -> np.ndarray:
    """Read a binary file of rows with `columns` values each; return all values, flat."""
    data = _bytes(path)
    if len(data) % (columns * np.dtype(dtype).itemsize):
        raise KittiError(
            f"{path}: {len(data)} bytes are not a multiple of {columns} {np.dtype(dtype)} values; "
            "fetch the file again"
        )
    return np.frombuffer(data, dtype)


def _table(path: Path, columns: int) -> np.ndarray:
    """Read (n, columns) float64 from a text file."""
    rows = [line.split() for line in _text(path).splitlines() if line.strip()]
    try:
        table = np.array([[float(value) for value in row] for row in rows])
    except ValueError:
        raise KittiError(f"{path}: expected {columns} numbers in each line") from None
    if table.ndim != 2 or table.shape[1] != columns or not np.isfinite(table).all():
        raise KittiError(f"{path}: expected {columns} finite numbers in each line")
    return table


def _matrices(path: Path) -> dict[str, np.ndarray]:
    """Read (3, 4) float64 by key, from lines like `P2: 12 numbers`; lines with `#` are comments."""
    out = {}
    for line in _text(path).splitlines():
        key, colon, values = line.partition(":")
        if not colon or line.lstrip().startswith("#"):
            continue
        try:
            out[key.strip()] = np.array([float(value) for value in values.split()]).reshape(3, 4)
        except ValueError:
            raise KittiError(f"{path}: {key}: expected 12 numbers") from None
    return out


def _text(path: Path) -> str:
    try:
        return _bytes(path).decode("ascii")
    except UnicodeDecodeError:
        raise KittiError(f"{path}: not an ASCII text file") from None
