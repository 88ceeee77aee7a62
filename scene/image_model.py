"""What a correct picture is: the one set of rules and constants that every renderer obeys.

With t = W·mu + p the mean in camera axes, M = J·W·R·diag(s) (2x3) and S' = M·Mᵀ + blur·I:

1.  cull            not (t.z >= near), or a value that is not finite, or a quaternion of zeros.
                    Values count as the model uses them: scale = exp(log-scale), opacity =
                    sigmoid(logit), so a logit of +inf is an opacity of 1 and stays visible.
                    "Finite" means finite in float32, whatever the precision of the renderer, so that
                    all renderers cull alike.
2.  Jacobian        t.x/t.z and t.y/t.z are clamped, in J only, to
                    [-c/f - margin·tan, (size - c)/f + margin·tan], tan = size / (2 f).
3.  antialiased     opacity *= sqrt(max(det(S' - blur·I), 0) / det S').
4.  alpha           min(max_alpha, o·exp(-½ dᵀ S'⁻¹ d)); below alpha_cut it is 0.
5.  order           front to back by t.z of the mean, ties by index.
6.  colour          max(0, 0.5 + SH(direction from the eye to mu)).
7.  pixel           C = Σ c·alpha·T, then background·T.

Sources: Kerbl et al. 2023 (3D Gaussian Splatting), Zwicker et al. 2002 (EWA splatting), Yu et al.
2024 (Mip-Splatting, for 3). `reference` is this table in float64.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

NEAR = 0.01
"""Nearest depth drawn, in world units; gsplat and Brush use the same."""

JACOBIAN_MARGIN = 0.3
"""How far beside the image, in units of tan(fov/2), the affine approximation is trusted (Kerbl et al.)."""

BLUR = 0.3
"""Variance in px² added to the footprint so that no splat is thinner than about a pixel (Kerbl et al.)."""

MAX_ALPHA = 0.99
"""Cap on one splat's alpha: transmittance never becomes exactly 0, so backward can divide by it."""

ALPHA_CUT = 1 / 255
"""An alpha below one grey level of an 8-bit picture is 0."""

MIN_QUAT_COMPONENT = 1e-30
"""A quaternion whose largest |component| is below this counts as zero.

Far above float32's subnormals, which GPUs flush to 0; renderers divide by the largest component before
they normalise, so any quaternion above this, however tiny or huge, keeps its direction."""


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


TEXTBOOK = ImageModel(jacobian_margin=None, blur=0.0, max_alpha=1.0, alpha_cut=0.0)
"""The bare model of the papers: no clamp, no blur, no cap, no cut."""


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """Everything besides scene and camera that decides a picture. Equal settings give equal pictures."""

    model: ImageModel = field(default_factory=ImageModel)
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """RGB, display-referred, blended behind the scene."""
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
    sigma_cut: float | None = None
    """Alpha is also 0 beyond so many standard deviations of the footprint; None: the alpha cut decides."""

    def __post_init__(self) -> None:
        if self.sigma_cut is not None and not self.sigma_cut > 0:
            raise ValueError(f"sigma_cut must be above 0, got {self.sigma_cut}")
        if self.early_stop is not None and not 0 <= self.early_stop < 1:
            raise ValueError(f"early_stop must be in [0, 1), got {self.early_stop}")
