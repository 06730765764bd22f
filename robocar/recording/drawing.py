"""Rerun's archetypes for the values of `robocar.core`, and the scenery."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, assert_never

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from robocar.core import SE2, Array, Detection, GridMap, Image, OccupancyGrid, Robot, Scan
from robocar.core.trace import Arrows, Circles, Drawable, Field, Lines, Points, Scalar, Segments, Text
from robocar.recording import palette
from robocar.recording.columns import ragged, single, vectors
from robocar.recording.scenery import Box, Cylinder, Scenery, Solid
from robocar.recording.streams import Streams

# Heights above the floor [m]: what explains lies over what it explains.
PRIOR_LAYER, MAP_LAYER, COST_LAYER, FIELD_LAYER = 0.002, 0.003, 0.004, 0.005
SENSOR_LAYER, PLAN_LAYER, OUTLINE_LAYER = 0.008, 0.012, 0.020
PATH_LAYER = {"odometry": 0.014, "estimate": 0.016, "truth": 0.018}

ELLIPSE_CORNERS = 33

WORLD_FRAME = "tf#/world"
"""Rerun's own name for the frame of entity `world`: the map frame."""


def turned(angle: float) -> rr.Quaternion:
    """A turn about the vertical [rad]."""
    return rr.Quaternion(xyzw=[0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)])


def transform(pose: SE2, z: float = 0.0) -> rr.Transform3D:
    """outer_from_inner of the plane at height z [m]."""
    return rr.Transform3D(translation=[pose.x, pose.y, z], quaternion=turned(pose.theta))


def grid_image(grid: GridMap, colors: NDArray[np.uint8], z: float) -> rr.GridMap:
    """A grid in colours (rows, cols, 4) RGBA. Rerun's row 0 lies at the top: this is the one flip."""
    rows, cols = grid.shape
    return rr.GridMap(
        data=np.ascontiguousarray(np.flipud(colors)).tobytes(),
        format=rr.components.ImageFormat(width=cols, height=rows, color_model="RGBA", channel_datatype="U8"),
        cell_size=grid.resolution,
        # Rerun honours the alpha of single cells only where the whole is not opaque.
        opacity=0.99 if z > 0 else 1.0,
        translation=[grid.origin.x, grid.origin.y, z],
        quaternion=turned(grid.origin.theta),
    )


def raised(points: Array, z: float) -> NDArray[np.float32]:
    """Points (n, 2) lifted to height z, points (n, 3) as they are, (n, 3) [m]."""
    flat = single(points)
    if flat.ndim == 2 and flat.shape[1] == 3:
        return flat
    flat = flat.reshape(-1, 2)
    return np.column_stack([flat, np.full(len(flat), z, dtype=np.float32)])


Row = dict[Any, pa.Array]
"""Values of one entity at one time, by component."""


def components(*parts: rr.AsComponents) -> Row:
    """The values that archetypes give."""
    batches = (batch for part in parts for batch in part.as_component_batches())
    return {batch.component_descriptor(): values for batch in batches if (values := batch.as_arrow_array()) is not None}


def drawable(item: Drawable, scale: float = 1.0) -> Row:
    """How a drawable of a trace looks, its radii times `scale`; `Scalar` and `Text` are no pictures.

    What planners draw several times a second is put into Arrow arrays right here: Rerun's archetypes take ten times as long.
    """
    match item:
        case Points(positions, values, color, radius, labels):
            row = {
                rr.Points3D.descriptor_positions(): vectors(raised(positions, PLAN_LAYER), 3),
                rr.Points3D.descriptor_colors(): _colors(values, color),
                rr.Points3D.descriptor_radii(): pa.array([radius * scale], pa.float32()),
            }
            if labels:
                row[rr.Points3D.descriptor_labels()] = pa.array(labels, pa.string())
            return row
        case Lines(lines, values, color, radius):
            return _line_strips([raised(line, PLAN_LAYER) for line in lines], _colors(values, color), radius * scale)
        case Segments(ends, color, radius):
            strips = raised(np.asarray(ends).reshape(-1, 2), PLAN_LAYER).reshape(-1, 2, 3)
            return _line_strips(strips, _colors(None, color), radius * scale)
        case Arrows(origins, directions, color, radius):
            return {
                rr.Arrows3D.descriptor_origins(): vectors(raised(origins, PLAN_LAYER), 3),
                rr.Arrows3D.descriptor_vectors(): vectors(raised(directions, 0.0), 3),
                rr.Arrows3D.descriptor_colors(): _colors(None, color),
                rr.Arrows3D.descriptor_radii(): pa.array([radius * scale], pa.float32()),
            }
        case Circles(centers, radii, shown, labels):
            rings = [circle(center, radius, 0.0)[:, :2] for center, radius in zip(centers, radii, strict=True)]
            colors = [palette.rgba32(color) for color in shown]
            return components(rr.LineStrips2D(rings, colors=colors, radii=rr.Radius.ui_points(1.5), labels=labels))
        case Field(grid):
            return components(grid_image(grid, palette.grid_colors(grid), FIELD_LAYER))
    raise TypeError(f"{type(item).__name__} cannot be drawn")


def _colors(values: Array | None, color: palette.Rgb) -> pa.Array:
    """0xRRGGBBAA of numbers from low to high, or of the one colour."""
    if values is None:
        return pa.array([palette.rgba32(color)], pa.uint32())
    channels = palette.viridis(np.ravel(values)).astype(np.uint32)
    return pa.array(channels @ np.array([1 << 24, 1 << 16, 1 << 8, 1], dtype=np.uint32))


def _line_strips(strips: Sequence[NDArray[np.float32]] | NDArray[np.float32], colors: pa.Array, radius: float) -> Row:
    corners = np.concatenate(strips) if len(strips) else np.empty((0, 3))
    return {
        rr.LineStrips3D.descriptor_strips(): ragged(corners, [len(strip) for strip in strips]),
        rr.LineStrips3D.descriptor_colors(): colors,
        rr.LineStrips3D.descriptor_radii(): pa.array([radius], pa.float32()),
    }


def drawable_bytes(item: Drawable) -> int:
    """Roughly what a drawable takes in the file [B]."""
    match item:
        case Points(positions):
            return 16 * len(positions)
        case Lines(lines):
            return 12 * sum(map(len, lines)) + 8 * len(lines)
        case Segments(ends):
            return 24 * len(ends)
        case Arrows(origins):
            return 24 * len(origins)
        case Field(grid):
            # Compressed: neighbouring cells resemble each other.
            return grid.data.size // 4
        case Circles() | Scalar() | Text():
            return 0
    assert_never(item)


def occupied_boxes(grid: OccupancyGrid) -> NDArray[np.int64]:
    """Rectangles that cover the occupied cells once: runs along the rows, joined where the next row repeats them.

    Returns:
        (n, 4) as row, col of the lowest cell, rows, cols.
    """
    rows, cols = grid.shape
    padded = np.zeros((rows, cols + 2), dtype=np.int8)
    padded[:, 1:-1] = grid.occupied
    steps = np.diff(padded, axis=1)
    boxes: list[list[int]] = []
    growing: dict[tuple[int, int], list[int]] = {}
    for row in range(rows):
        starts, ends = np.flatnonzero(steps[row] == 1), np.flatnonzero(steps[row] == -1)
        runs: dict[tuple[int, int], list[int]] = {}
        for run in zip(starts.tolist(), ends.tolist(), strict=True):
            box = growing.get(run)
            if box is None:
                box = [row, run[0], 0, run[1] - run[0]]
                boxes.append(box)
            box[2] += 1
            runs[run] = box
        growing = runs
    return np.array(boxes, dtype=np.int64).reshape(-1, 4)


def walls(grid: OccupancyGrid, height: float) -> rr.Boxes3D:
    """The occupied cells as boxes of `height` [m]."""
    row, col, rows, cols = occupied_boxes(grid).T
    half = grid.resolution / 2
    centres = grid.origin.transform(np.stack([(2 * col + cols) * half, (2 * row + rows) * half], axis=1))
    heights = np.full(len(centres), height / 2)
    return rr.Boxes3D(
        centers=np.column_stack([centres, heights]),
        half_sizes=np.column_stack([cols * half, rows * half, heights]),
        quaternions=[turned(grid.origin.theta)] * len(centres),
        colors=[palette.rgba32(palette.WALL)],
        fill_mode="solid",
    )


def solid(shape: Solid, color: palette.Rgb) -> rr.AsComponents:
    """A box or a cylinder on the floor."""
    pose = shape.pose
    match shape:
        case Box((length, width, height)):
            return rr.Boxes3D(
                centers=[[pose.x, pose.y, height / 2]],
                sizes=[[length, width, height]],
                quaternions=[turned(pose.theta)],
                colors=[palette.rgba32(color)],
                fill_mode="solid",
            )
        case Cylinder():
            return cylinders([shape], color)


def cylinders(shapes: Sequence[Cylinder], color: palette.Rgb) -> rr.Cylinders3D:
    """Cylinders on the floor."""
    return rr.Cylinders3D(
        centers=[[shape.pose.x, shape.pose.y, shape.height / 2] for shape in shapes],
        lengths=[shape.height for shape in shapes],
        radii=[shape.radius for shape in shapes],
        colors=[palette.rgba32(color)],
        fill_mode="solid",
    )


def outline(vertices: Array, z: float) -> NDArray[np.float32]:
    """A polygon (n, 2) as a closed line, (n + 1, 3) [m]."""
    return raised(np.concatenate([vertices, vertices[:1]]), z)


def circle(center: Array, radius: float, z: float) -> NDArray[np.float32]:
    """(49, 3) [m]"""
    angles = np.linspace(0.0, 2 * np.pi, 49)
    return raised(center + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1), z)


def cone(bearing: float, beam_width: float) -> rr.Mesh3D:
    """A sector of a disc of radius 1 m: the opening of a sonar; its colour and length come with each reading."""
    half = max(beam_width, math.radians(1.0)) / 2
    angles = np.linspace(bearing - half, bearing + half, 13)
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(13)], axis=1)
    corners = np.arange(1, 13)
    return rr.Mesh3D.from_fields(
        vertex_positions=np.concatenate([np.zeros((1, 3)), rim]),
        triangle_indices=np.stack([np.zeros(12, dtype=int), corners, corners + 1], axis=1),
        vertex_normals=np.tile([0.0, 0.0, 1.0], (14, 1)),
    )


def detections(seen: tuple[Detection, ...]) -> rr.LineStrips3D:
    """A ray from the robot to each landmark that it sees, in the robot's frame."""
    drawn = [d for d in seen if math.isfinite(d.bearing) and math.isfinite(d.range)]
    ends = [(d.range * math.cos(d.bearing), d.range * math.sin(d.bearing)) for d in drawn]
    rays = [raised(np.array([(0.0, 0.0), end]), SENSOR_LAYER) for end in ends]
    labels = [d.landmark for d in drawn]
    return rr.LineStrips3D(rays, colors=[palette.rgba32(palette.LASER)], radii=rr.Radius.ui_points(1.0), labels=labels)


def laser_hits(scan: Scan, most: int) -> NDArray[np.float32]:
    """The points that a scan hit, every k-th where there are more than `most` beams, (n, 3) [m] in the sensor's frame."""
    every = max(1, -(-len(scan.ranges) // most))
    ranges, bearings = scan.ranges[::every], scan.bearings[::every]
    heard = np.isfinite(ranges) & np.isfinite(bearings)
    points = ranges[heard, None] * np.stack([np.cos(bearings[heard]), np.sin(bearings[heard])], axis=1)
    return raised(points, 0.0)


def camera(image: Image) -> list[rr.AsComponents]:
    """Pinhole and mount of a camera; the camera's frame is OpenCV's, which is Rerun's own."""
    height, width = image.pixels.shape[:2]
    mount = np.asarray(image.robot_from_camera)
    return [
        rr.Pinhole(image_from_camera=image.intrinsics, resolution=[width, height], image_plane_distance=0.25),
        rr.Transform3D(translation=mount[:3, 3], mat3x3=mount[:3, :3]),
    ]


def covariance_ellipses(positions: Array, covariances: Array) -> NDArray[np.float32]:
    """Where the position lies with 95 % probability: the chi-square quantile with two degrees of freedom is -2 ln 0.05.

    Args:
        positions: (n, 2) [m].
        covariances: of x and y, (n, 2, 2) [m^2].

    Returns:
        Closed lines of 33 points one after the other, (33 n, 3) [m].
    """
    values, axes = np.linalg.eigh(covariances)
    scales = axes * np.sqrt(np.maximum(values, 0.0) * -2.0 * math.log(0.05))[:, None, :]
    angles = np.linspace(0.0, 2 * np.pi, ELLIPSE_CORNERS)
    rims = positions[:, None] + np.stack([np.cos(angles), np.sin(angles)], axis=1) @ scales.transpose(0, 2, 1)
    return raised(rims.reshape(-1, 2), OUTLINE_LAYER)


def particles(weighted: Array, most: int) -> rr.Arrows3D:
    """At most `most` of the particles (n, 4) as x, y, theta, weight, as short arrows along their headings, coloured by weight."""
    some = weighted[:: -(-len(weighted) // most)]
    headings = 0.08 * np.stack([np.cos(some[:, 2]), np.sin(some[:, 2])], axis=1)
    alike = np.ptp(some[:, 3]) <= 1e-9 * np.max(np.abs(some[:, 3]))
    return rr.Arrows3D(
        origins=raised(some[:, :2], SENSOR_LAYER),
        vectors=raised(headings, 0.0),
        colors=[palette.rgba32(palette.PARTICLES)] if alike else palette.viridis(some[:, 3]),
        radii=0.006,
    )


def log_scenery(stream: Streams, scenery: Scenery) -> None:
    """Everything that does not change, as static data."""

    def static(entity: str, *archetypes: rr.AsComponents) -> None:
        stream.log(entity, *archetypes)

    static("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    if (truth := scenery.truth) is not None:
        static("world/map/truth", grid_image(truth, palette.WORLD[truth.data.view(np.uint8)], 0.0))
        if truth.occupied.any():
            static("world/map/truth/walls", walls(truth, scenery.wall_height))
    if (prior := scenery.prior) is not None:
        static("world/map/prior", grid_image(prior, palette.PRIOR[prior.data.view(np.uint8)], PRIOR_LAYER))
    for k, shape in enumerate(shape for shape in scenery.solids if isinstance(shape, Box)):
        static(f"world/obstacles/{k}", solid(shape, palette.SOLID))
    if pillars := [shape for shape in scenery.solids if isinstance(shape, Cylinder)]:
        static("world/obstacles/cylinders", cylinders(pillars, palette.SOLID))  # some worlds have hundreds
    for name, shape in scenery.movers.items():
        static(f"world/movers/{rr.escape_entity_path_part(name)}/shape", solid(shape, palette.MOVER))
    if scenery.landmarks:
        static(
            "world/landmarks",
            rr.Points3D(
                [mark.position for mark in scenery.landmarks],
                radii=[mark.radius for mark in scenery.landmarks],
                colors=palette.packed([palette.LANDMARKS.get(mark.color, (120, 120, 120)) for mark in scenery.landmarks]),
                labels=[mark.name for mark in scenery.landmarks],
                show_labels=False,
            ),
        )
    if (goal := scenery.goal) is not None:
        strips = [circle(goal.position, r, PLAN_LAYER) for r in (goal.xy_goal_tolerance, 0.02)]
        if goal.heading is not None:
            ahead = goal.position + 0.3 * np.array([math.cos(goal.heading), math.sin(goal.heading)])
            strips.append(raised(np.stack([goal.position, ahead]), PLAN_LAYER))
        ring = rr.LineStrips3D(strips, colors=[palette.rgba32(palette.GOAL)], radii=rr.Radius.ui_points(2.0))
        static("world/goal", ring)
    if scenery.robot is not None:
        _log_robot(static, scenery.robot)


def _log_robot(static, robot: Robot) -> None:
    """A body and four wheels within the footprint at the true pose, outlines at the estimated ones."""
    vertices = robot.footprint.vertices
    wheel, front, rear = robot.calibration.wheel_radius, vertices[:, 0].max(), vertices[:, 0].min()
    side, tread = np.abs(vertices[:, 1]).max(), 0.6 * wheel
    body_low, body_high = 0.6 * wheel, 2.4 * wheel
    static("world/robot", rr.Transform3D(parent_frame="tf#/world/truth"))
    static(
        "world/robot/body",
        rr.Boxes3D(
            mins=[[rear, tread - side, body_low], [front - 0.25 * (front - rear), 0.3 * -side, body_high]],
            sizes=[
                [front - rear, 2 * (side - tread), body_high - body_low],
                [0.2 * (front - rear), 0.6 * side, 0.6 * wheel],
            ],
            colors=palette.packed([palette.CAR_BODY, palette.WHEEL]),
            fill_mode="solid",
        ),
    )
    axles = np.array([front - 1.2 * wheel, rear + 1.2 * wheel])
    centres = [[x, y, wheel] for x in axles for y in (side - tread / 2, tread / 2 - side)]
    static(
        "world/robot/wheels",
        rr.Cylinders3D(
            centers=centres,
            lengths=[tread] * 4,
            radii=[wheel] * 4,
            # The axis of a wheel is the car's y.
            quaternions=[[math.sin(math.pi / 4), 0.0, 0.0, math.cos(math.pi / 4)]] * 4,
            colors=[palette.rgba32(palette.WHEEL)],
            fill_mode="solid",
        ),
    )
    nose = np.array([[0.0, 0.0], [1.25 * front, 0.0]])
    for name, color in (("truth", palette.TRUTH), ("odometry", palette.ODOMETRY), ("estimate", palette.ESTIMATE)):
        lines = [outline(vertices, OUTLINE_LAYER), raised(nose, OUTLINE_LAYER)]
        static(f"world/{name}/footprint", rr.LineStrips3D(lines, colors=[palette.rgba32(color)], radii=rr.Radius.ui_points(1.5)))
