"""The receipt of effects while the view turns."""

from __future__ import annotations

from splatview.scene.formats import save_scene
from splatview.viewer.navigation import orbit
from splatview.viewer.open import open_paths
from splatview.viewer.quality.effects import MOVING_SECONDS, Effects


def test_the_number_of_effects_stands_while_the_view_turns(
    app, random_gaussians, wait_for_loading, tmp_path
) -> None:
    save_scene(random_gaussians(50), tmp_path / "a.ply")
    open_paths(app, [tmp_path / "a.ply"])
    wait_for_loading(app)
    app.examination.join()
    effects, clock = app.feature(Effects), [0.0]
    app.now = lambda: clock[0]

    def computed(*, turned: float = 0.0, seconds: float = 1 / 60) -> int:
        clock[0] += seconds
        if turned:
            app.steer(orbit(app.view, turned, 0))
        effects.before_frame(app)
        return sum(effect.in_force for effect in effects.receipt(app))

    computed()
    at_rest = computed(seconds=2 * MOVING_SECONDS)
    turning = {computed(turned=0.01 * (frame % 3 == 0)) for frame in range(30)}
    assert turning == {at_rest + 1}, "whichever frames the hand leaves out"
    assert computed(seconds=2 * MOVING_SECONDS) == at_rest
