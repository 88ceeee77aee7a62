"""Depth order pixel by pixel, as far as a short memory reaches: no splat jumps before another at once.

In the global order a splat is in front of another everywhere, and a small turn of the camera changes that
everywhere at once: it pops. Here each pixel has its own depth of a splat, where the splat is densest along
the pixel's ray (Radl et al. 2024, StopThePop), and holds back the NEAREST nearest splats of the global order
met so far, blending the nearest of them whenever another one comes.

Under the affine projection of `scene.image_model`, depth and place in the image are one three-dimensional
Gaussian, so the depth along a ray is linear in the pixel: z(d) = t.z + g·d, g = S'⁻¹·cov(image, depth).
"""

from __future__ import annotations

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.edits import LOG_FACTOR, QUAT, EditArrays
from splatview.raster.parameters import TILE, Parameters
from splatview.raster.project import BLUE, GREEN, LOG2_OPACITY, RED, X_REST, Y_REST, A, B, C, X, Y
from splatview.raster.surfels import exponent_and_depth
from splatview.scene import Camera, RenderSettings
from splatview.scene.edits import PALETTE_SHIFT
from splatview.scene.projection import projection_jacobians, rotation_matrices

NEAREST = 16
"""Splats that a pixel holds back: splats further out of order are blended out of order."""

# Columns of the splats that a pixel holds back.
HELD_DEPTH, HELD_ALPHA, HELD_SPLAT = range(3)


def depth_slopes(
    splats: Parameters,
    visible: np.ndarray,
    camera: Camera,
    settings: RenderSettings,
    edits: EditArrays | None = None,
) -> np.ndarray:
    """g of each splat in `visible` (V,) int32: (N, 2) float64, world units a px; 0 for the others."""
    slopes = np.zeros((len(splats.means), 2))
    means, quats, log_scales = (
        values[visible].astype(np.float64) for values in (splats.means, splats.quats, splats.log_scales)
    )
    R = rotation_matrices(quats)
    if edits is not None:
        rows = edits.palette[np.minimum(edits.marks[visible] >> PALETTE_SHIFT, len(edits.palette) - 1)]
        to_world = rows[:, :12].reshape(-1, 3, 4)
        means = np.einsum("nij,nj->ni", to_world[:, :, :3], means) + to_world[:, :, 3]
        R = rotation_matrices(rows[:, QUAT : QUAT + 4]) @ R
        log_scales += rows[:, LOG_FACTOR, None]
    t = (means - camera.eye) @ camera.R_camera_world.T
    axes = camera.R_camera_world @ R * np.exp(log_scales)[:, None, :]
    M = projection_jacobians(t, camera, settings.model.jacobian_margin) @ axes
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        S = M @ M.transpose(0, 2, 1)
        xx, xy, yy = S[:, 0, 0] + settings.model.blur, S[:, 0, 1], S[:, 1, 1] + settings.model.blur
        covariance = np.einsum("nij,nj->ni", M, axes[:, 2])
        det = xx * yy - xy * xy
        found = np.stack(
            [
                (yy * covariance[:, 0] - xy * covariance[:, 1]) / det,
                (xx * covariance[:, 1] - xy * covariance[:, 0]) / det,
            ],
            axis=1,
        )
    # A splat with a determinant without digits keeps the depth of its mean.
    good = np.isfinite(found).all(axis=1) & (det > 1e-9 * xx * yy)
    slopes[visible[good]] = found[good]
    return slopes


@inline
def take_nearest(held, count, records, pixel):
    """Blends the first of `held` into pixel (4,), transmittance and colour, and moves the others up."""
    record = records[np.int64(held[HELD_SPLAT, 0])]
    weight = held[HELD_ALPHA, 0] * pixel[0]
    pixel[1] += weight * record[RED]
    pixel[2] += weight * record[GREEN]
    pixel[3] += weight * record[BLUE]
    pixel[0] *= 1 - held[HELD_ALPHA, 0]
    for place in range(count - 1):
        for column in range(3):
            held[column, place] = held[column, place + 1]


@inline
def hold_back(held, count, depth, alpha, splat):
    """Puts a splat in its place among `count` held ones; of equal depth the earlier one stays in front."""
    place = count
    while place > 0 and held[HELD_DEPTH, place - 1] > depth:
        for column in range(3):
            held[column, place] = held[column, place - 1]
        place -= 1
    held[HELD_DEPTH, place], held[HELD_ALPHA, place], held[HELD_SPLAT, place] = depth, alpha, splat


@kernel(allocates=True)
def draw_tiles_by_pixel(
    start, stop, offsets, base, lists, records, surfels, view, depths, slopes, background, stop_below, image
):
    """Draws tiles [start, stop) into image (H, W, 4); returns how many alphas were evaluated.

    depths (N,) float64 of the means and slopes (N, 2) float64 as `depth_slopes`; surfels take their planes'
    depths instead. The others as in `forward`.
    """
    held = np.empty((3, NEAREST + 1))
    pixel = np.empty(4)
    evaluated = 0
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        first, end = offsets[tile] - base, offsets[tile + 1] - base
        for y in range(top, min(top + TILE, view.height)):
            for x in range(left, min(left + TILE, view.width)):
                pixel[0], pixel[1], pixel[2], pixel[3] = 1.0, 0.0, 0.0, 0.0
                count = 0
                for k in range(first, end):
                    if not pixel[0] >= stop_below:
                        break
                    splat = lists[k]
                    record = records[splat]
                    dx = (x + 0.5 - np.float64(record[X])) - record[X_REST]
                    dy = (y + 0.5 - np.float64(record[Y])) - record[Y_REST]
                    depth = depths[splat]
                    if surfels is None:
                        u, v = record[A] * dx + record[B] * dy, record[C] * dy
                        power = record[LOG2_OPACITY] - u * u - v * v
                        depth += slopes[splat, 0] * dx + slopes[splat, 1] * dy
                    else:
                        distance, depth = exponent_and_depth(surfels, splat, dx, dy, depth)
                        power = record[LOG2_OPACITY] - distance
                    evaluated += 1
                    if not power >= max(view.log2_cut, record[LOG2_OPACITY] + view.log2_share):
                        continue
                    alpha = min(2.0**power, view.max_alpha)
                    hold_back(held, count, depth, alpha, splat)
                    count += 1
                    if count > NEAREST:
                        take_nearest(held, count, records, pixel)
                        count -= 1
                while count > 0:
                    take_nearest(held, count, records, pixel)
                    count -= 1
                for channel in range(3):
                    image[y, x, channel] = pixel[1 + channel] + pixel[0] * background[channel]
                image[y, x, 3] = 1 - pixel[0]
    return evaluated
