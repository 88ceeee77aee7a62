"""What a correct picture is: the one set of rules and constants that every renderer obeys.

With t = W·mu + p the mean in camera axes, M = J·W·R·diag(s) (2x3) and S' = M·Mᵀ + blur·I:

1.  cull            not (t.z >= near), or a value that is not finite, or a quaternion of zeros, or a mean
                    beyond the reach of the lens.
                    Values count as the model uses them: scale = exp(log-scale), opacity =
                    sigmoid(logit), so a logit of +inf is an opacity of 1 and stays visible.
                    "Finite" means finite in float32, whatever the precision of the renderer, so that
                    all renderers cull alike.
2.  Jacobian        t.x/t.z and t.y/t.z are clamped, in J only, to what the picture sees and `margin` times
                    half of that range beyond, on either side. For a pinhole that is
                    [-c/f - margin·tan, (size - c)/f + margin·tan], tan = size / (2 f).
3.  antialiased     opacity *= sqrt(max(det(S' - blur·I), 0) / det S').
4.  alpha           min(max_alpha, o·exp(-½ dᵀ S'⁻¹ d)); below alpha_cut it is 0.
5.  order           front to back by t.z of the mean, ties by index.
6.  colour          max(0, 0.5 + SH(direction from the eye to mu)).
7.  pixel           C = Σ c·alpha·T, then background·T.

The mean is seen at f·t.xy/t.z + c, and J is the derivative of that by t. Two kinds of camera differ:

lens                (u, v) = t.xy/t.z goes to `lens.distort` of it before f and c, and
                    J = diag(f)·J_lens(u, v)·J_pinhole, u and v clamped in both. The clamp is of the ray
                    without distortion: it keeps J near rays that the picture sees, whatever the lens makes
                    of them. Where a lens polynomial turns back on itself its reach ends; a mean beyond is
                    culled, as it would be shown again inside the picture. What is behind the eye is not
                    seen by fisheyes either: t.z >= near.
orthographic        the mean is seen at f·t.xy + c, f in px per world unit; J = [diag(f) 0] needs no clamp.
                    Depth is t.z as ever, and culled by near. The direction for the colour is the viewing
                    direction, the same for all splats.

With the footprint "disc", for scenes trained so, splats are flat: the two larger scales are those of an
ellipse in the plane of their axes, the third axis is the plane's normal n (the last axis, of equal scales),
and what pixels see is no longer an affine picture of it. Then these take the place of 2 to 4:

2d. plane           n is turned so that n·ray > 0 for the ray to the mean. A scale that the mean's depth makes
                    less than DISC_LEAST_WIDTH px counts as that much.
3d. antialiased     has no effect: the blur of 4d replaces thin footprints instead of widening all.
4d. alpha           min(max_alpha, o·max(G_plane, G_screen)); below alpha_cut it is 0.
                    G_plane = exp(-½(u² + v²)), where the pixel's ray meets the plane, u and v in units of the
                    two scales from the mean. It is 0 where that is nearer than near, and where
                    n·ray < DISC_LEAST_SLOPE for the ray with z = 1 (or a parallel one of length 1): a plane
                    seen so nearly edge-on that rounding decides where it is met.
                    G_screen = exp(-½|d|² / blur) about the projected mean: a disc is never less than a dot,
                    and seen edge-on it is that dot alone. blur is DISC_BLUR for scenes trained so; with 0 the
                    dot is a point.

Order and cull, near among it, go by the mean as ever. A disc is not seen through a lens.

Sources: Kerbl et al. 2023 (3D Gaussian Splatting), Zwicker et al. 2002 (EWA splatting), Yu et al.
2024 (Mip-Splatting, for 3), Huang et al. 2024 (2D Gaussian Splatting, for 4d: eq. 8 to 11; the limits are
ours). `reference` is this table in float64.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from splatview.scene.background import Background

NEAR = 0.01
"""Nearest depth drawn, in world units; gsplat and Brush use the same."""

JACOBIAN_MARGIN = 0.3
"""How far beside the image, in units of tan(fov/2), the affine approximation is trusted (Kerbl et al.)."""

BLUR = 0.3
"""Variance in px² added to the footprint so that no splat is thinner than about a pixel (Kerbl et al.)."""

DISC_BLUR = 0.5
"""Variance in px² of the dot that a disc is at least (Huang et al. 2024, eq. 11)."""

DISC_LEAST_SLOPE = 2.0**-10
"""Of a ray against the plane that it meets. Directions in float32 are good to some 3e-7: where a ray this
flat meets a plane is known to 3e-4 of the distance, an alpha to 2e-4. Cut off is a strip of f/1024 px below a
plane's horizon."""

DISC_LEAST_WIDTH = 1 / 64
"""px: a pixel centre hits a thinner line by chance only, and with an alpha that rounding decides."""

MAX_ALPHA = 0.99
"""Cap on one splat's alpha: transmittance never becomes exactly 0, so backward can divide by it."""

ALPHA_CUT = 1 / 255
"""An alpha below one grey level of an 8-bit picture is 0."""

MIN_QUAT_COMPONENT = 1e-30
"""A quaternion whose largest |component| is below this counts as zero.

Far above float32's subnormals, which GPUs flush to 0; renderers divide by the largest component before
they normalise, so any quaternion above this, however tiny or huge, keeps its direction."""


Footprint = Literal["ellipsoid", "disc"]

Order = Literal["32-bit", "16-bit", "per-pixel", "weighted", "stochastic"]


@dataclass(frozen=True, kw_only=True)
class ImageModel:
    """The constants of the image model; the defaults are what scenes are trained with."""

    near: float = NEAR
    jacobian_margin: float | None = JACOBIAN_MARGIN
    """None: no clamp."""
    blur: float = BLUR
    antialiased: bool = False
    max_alpha: float = MAX_ALPHA
    alpha_cut: float = ALPHA_CUT
    """0: no cut; every splat reaches every pixel."""
    footprint: Footprint = "ellipsoid"
    """Whether splats are solid or flat, see steps 2d to 4d."""

    def with_footprint(self, footprint: Footprint) -> ImageModel:
        """The same model of the other footprint, with the blur that scenes of that kind are trained with."""
        if footprint == self.footprint:
            return self
        return replace(self, footprint=footprint, blur=DISC_BLUR if footprint == "disc" else BLUR)


TEXTBOOK = ImageModel(jacobian_margin=None, blur=0.0, max_alpha=1.0, alpha_cut=0.0)
"""The bare model of the papers: no clamp, no blur, no cap, no cut."""


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """Everything besides scene and camera that decides a picture. Equal settings give equal pictures."""

    model: ImageModel = field(default_factory=ImageModel)
    background: Background = (0.0, 0.0, 0.0)
    """Display-referred, blended behind the scene: RGB, or what is seen along the pixels' rays."""
    sh_degree: int | None = None
    """Highest SH degree evaluated; None: all that the scene stores."""
    blend: Literal["float16", "float32", "unorm8"] = "float16"
    """Precision of the target that `quads` blends into; renderers that keep sums in registers use float32."""
    early_stop: float | None = None
    """Transmittance below which a pixel is finished; 0: never; None: the renderer's own (below 2e-4).
    A pixel's error is at most this times the brightest colour behind."""

    order: Order = "32-bit"
    """How splats come front to back.

    32-bit: by keys that tell all depths apart, whole splats before or behind each other.
    16-bit: by coarser keys, ties by index.
    per-pixel: by where each pixel's ray meets the splat, which the image model does not know.
    weighted: not sorted; nearer splats count more in a sum, and the light that comes through is right.
    stochastic: not sorted; each pixel shows one splat, by chance, as often as the image model would.
    """
    resort_frames: int = 1
    """While the camera moves, the order is made anew in every so many frames only: pictures then depend on
    those before. At rest it is that of the view."""
    resort_degrees: float = 0.0
    """Above 0: instead, when the camera has turned or moved by so much, by `resort_policy.view_change`."""
    sigma_cut: float | None = None
    """Alpha is also 0 beyond so many standard deviations of the footprint; None: the alpha cut decides."""

    def __post_init__(self) -> None:
        if self.sigma_cut is not None and not self.sigma_cut > 0:
            raise ValueError(f"sigma_cut must be above 0, got {self.sigma_cut}")
        if not self.resort_frames >= 1 or not self.resort_degrees >= 0:
            raise ValueError(
                f"resort_frames must be at least 1 and resort_degrees at least 0, got {self.resort_frames} "
                f"and {self.resort_degrees}"
            )
        if self.early_stop is not None and not 0 <= self.early_stop < 1:
            raise ValueError(f"early_stop must be in [0, 1), got {self.early_stop}")
