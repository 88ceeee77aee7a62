"""A feature: one subject of the window with a state of its own, such as editing or depth of field."""

from __future__ import annotations

from typing import TYPE_CHECKING

from splatview.renderers.request import Highlight
from splatview.scene.edits import SceneEdits

if TYPE_CHECKING:
    from splatview.viewer.loading import LoadedScene
    from splatview.viewer.state import AppState


class Feature:
    """Base of all features, which does nothing. `viewer.app` registers them; all methods run on the GL
    thread, between two frames."""

    @property
    def edits(self) -> SceneEdits | None:
        """Edits of the open scene to be drawn."""
        return None

    @property
    def highlight(self) -> Highlight | None:
        """Highlight of those edits on the picture."""
        return None

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        """Another scene is open, in the place of the one before."""

    def before_frame(self, app: AppState) -> None:
        """Takes over finished work and prepares the frame that follows."""

    def busy(self, app: AppState) -> bool:
        """Whether work is under way whose result a next frame should show."""
        return False

    def cancel(self, app: AppState) -> bool:
        """Ends the latest thing that the user began; whether there was one. For the Escape key."""
        return False

    def close(self, app: AppState) -> None:
        """Ends work under way and frees GL objects; the window closes."""
