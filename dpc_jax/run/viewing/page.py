"""The page of the live view: one shape at a time, its views, what is known of them."""

import contextlib
import io
import math
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import viser

from dpc_jax.config import Render
from dpc_jax.evaluation.images import resize
from dpc_jax.evaluation.rotations import to_rotation, view_angles
from dpc_jax.files import describe_error
from dpc_jax.outputs import show_text
from dpc_jax.reporting.export import PLAIN_COLOR, export_glb, find_surface
from dpc_jax.run.viewing import ShownObject, ShownView
from dpc_jax.run.viewing.shape_files import read_shapes
from dpc_jax.run.workdir import read_config

_BEST, _OTHERS, _CHOSEN = (40, 160, 70), (150, 150, 150), (200, 80, 30)  # cameras
_ROWS = 8  # of the table of candidates
_SECONDS = 2.0  # between looks for a new checkpoint
# From y up and z to the front to z up and x to the front.
_FROM_GLTF = (0.5, 0.5, 0.5, 0.5)
_POINT = 0.008  # object units


class Page:
    """What a browser shows; every method may be called from any thread."""

    def __init__(self, server: viser.ViserServer, camera: Render):
        """camera: of a config, because a `Camera` would load JAX: seconds."""
        self._server, self._camera = server, camera
        self._lock = threading.RLock()
        # Of the run or the files, and of images that were given to the page.
        self._own: list[ShownObject] = []
        self._given: list[ShownObject] = []
        self._shapes: dict[str, ShownObject] = {}  # of both, as the page lists them
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.scene.set_up_direction("+z")
        server.initial_camera.position = (1.9, 1.2, 0.9)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        self._status = server.gui.add_markdown("")
        self._object: Any = server.gui.add_dropdown("Shape", ("none",))
        self._view: Any = server.gui.add_dropdown("View", ("none",))
        names = ("Points", "Surface", "Cameras", "Candidates")
        self._parts = {n: server.gui.add_checkbox(n, n != "Surface") for n in names}
        self._picture = server.gui.add_image(np.zeros((1, 2, 3), np.uint8))
        self._table = server.gui.add_markdown("")
        self._object.on_update(lambda _: self._choose_object())
        for handle in (self._view, *self._parts.values()):
            handle.on_update(lambda _: self._draw())

    def say(self, text: str):
        """Show a sentence on top."""
        self._status.content = text

    def show(self, objects: list[ShownObject]):
        """Show these shapes, and those of given images; what is chosen stays chosen."""
        with self._lock:
            self._own = objects
            shapes = enumerate([*self._own, *self._given])
            self._shapes = {f"{i + 1}. {one.name}": one for i, one in shapes}
            _offer(self._object, list(self._shapes) or ["none"])
            self._choose_object()

    def add_upload(self, predict):
        """Have a button for an image; `predict` makes shapes of a file's path."""
        button = self._server.gui.add_upload_button(
            "Give an image", mime_type="image/*"
        )

        @button.on_upload
        def _(_):
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / (Path(button.value.name).name or "image")
                path.write_bytes(button.value.content)
                try:
                    found = predict(path)
                except (OSError, ValueError) as error:
                    text = describe_error(error).replace(f"{folder}/", "")
                    self.say(f"**{show_text(path.name)}**: {text}")
                    return
            with self._lock:
                self._given += found
                self.show(self._own)
                self._object.value = self._object.options[-1]
                self._choose_object()
            self.say(f"Shape of **{show_text(path.name)}**.")

    def _choose_object(self):
        with self._lock:
            count = len(self._find_object().views)
            _offer(self._view, [str(i + 1) for i in range(count)] or ["none"])
            self._draw()

    def _find_object(self) -> ShownObject:
        return self._shapes.get(str(self._object.value), ShownObject("none"))

    def _draw(self):
        with self._lock, self._server.atomic():
            self._server.scene.reset()
            one, parts = self._find_object(), self._parts
            place = int(self._view.value) - 1 if self._view.value != "none" else 0
            view = one.views[place] if place < len(one.views) else None
            if one.points is not None and parts["Points"].value:
                self._add_cloud(one.points, one.colors)
            if parts["Surface"].value or one.points is None:
                self._add_surface(one)
            for i, other in enumerate(one.views if parts["Cameras"].value else ()):
                color = _CHOSEN if i == place else _OTHERS
                self._add_camera(f"/cameras/{i + 1}", other.pose, color, other.image)
            if view and view.candidates and parts["Candidates"].value:
                best = np.argmin(view.candidates.losses)
                for i, pose in enumerate(view.candidates.poses):
                    color = _BEST if i == best else _OTHERS
                    self._add_camera(f"/candidates/{i + 1}", pose, color, scale=0.06)
            self._picture.image = _draw_picture(view)
            self._table.content = _describe_view(view)

    def _add_cloud(self, points, colors):
        if colors is None:
            colors = np.broadcast_to(PLAIN_COLOR, points.shape)
        self._server.scene.add_point_cloud(
            "/points",
            np.asarray(points, np.float32),
            np.round(255 * np.clip(colors, 0, 1)).astype(np.uint8),
            point_size=_POINT,
            point_shape="circle",
        )

    def _add_surface(self, one: ShownObject):
        data = one.surface
        if data is None and one.points is not None:
            data = export_glb(*find_surface(one.points, one.colors))
        if data is not None:
            self._server.scene.add_glb("/surface", data, wxyz=_FROM_GLTF)

    def _add_camera(self, name, pose, color, image=None, scale=0.12) -> Any:
        turn = to_rotation(pose)
        x, y, z, w = turn.inv().as_quat()
        return self._server.scene.add_camera_frustum(
            name,
            2 * math.atan(0.5 / self._camera.focal_length),
            1.0,
            scale=scale,
            thickness=0.004,
            color=color,
            image=image,
            wxyz=(w, x, y, z),
            position=turn.inv().apply([0, 0, -self._camera.distance]),
        )


def _offer(dropdown: Any, options: list[str]):
    """Give a dropdown other options; the chosen one stays where it is among them."""
    chosen = dropdown.value
    dropdown.options = options
    dropdown.value = chosen if chosen in options else options[0]


def _draw_picture(view: ShownView | None) -> np.ndarray:
    """The image of a view beside the predicted silhouette, uint8 [S, 2·S, 3]."""
    if view is None or view.image is None:
        return np.full((1, 2, 3), 255, np.uint8)
    image, side = view.image, len(view.image)
    silhouette = np.zeros((side, side)) if view.silhouette is None else view.silhouette
    shown = np.round(255 * (1 - resize(silhouette, side))).astype(np.uint8)
    pair = np.concatenate([image, np.repeat(shown[..., None], 3, axis=-1)], axis=1)
    return pair.repeat(4, axis=0).repeat(4, axis=1)  # browsers would blur it


def _describe_view(view: ShownView | None) -> str:
    """Where a view is seen from, and its best candidates; Markdown."""
    if view is None:
        return ""
    text = "Seen from azimuth {:.0f}°, elevation {:.0f}°.".format(
        *view_angles(view.pose)
    )
    if view.candidates is None:
        return text
    lines = ["", "| azimuth | elevation | probability | loss |", "|--:|--:|--:|--:|"]
    for i in np.argsort(view.candidates.losses)[:_ROWS]:
        azimuth, elevation = view_angles(view.candidates.poses[i])
        chance, loss = view.candidates.probabilities[i], view.candidates.losses[i]
        lines.append(
            f"| {azimuth:.0f}° | {elevation:.0f}° | {chance:.2f} | {loss:.1f} |"
        )
    return "\n".join([text, *lines])


def serve(paths: list[Path], *, port: int, data: Path | None):
    """Serve the page until Ctrl-C.

    Args:
      paths: one run, or folders and files of shapes. port: the first that is tried.
      data: folder of the run's rendered data; None for that of its config.
    """
    if not 0 < port < 65_536:
        raise ValueError(
            f"--port must be a number from 1 to 65535, but it is {port}; leave it out."
        )
    runs = [path for path in paths if (path / "config.json").is_file()]
    if runs and len(paths) > 1:
        raise ValueError(
            f"Expected one run, or files, but {runs[0]} and {len(paths) - 1} more were "
            "given; view a run on its own."
        )
    camera = Render()
    if runs:
        camera = read_config(runs[0]).render
        # Until the network is read.
        paths = sorted((runs[0] / "report" / "points").glob("*.ply"))
    objects = read_shapes(paths)
    with contextlib.redirect_stdout(io.StringIO()):  # of a box with the address
        server = viser.ViserServer("127.0.0.1", port, "dpc_jax", verbose=False)
    try:
        print(
            f"Page: http://127.0.0.1:{server.get_port()} (Ctrl-C ends it)", flush=True
        )
        page = Page(server, camera)
        page.show(objects)
        page.say(f"Shapes: {len(objects)}.")
        if runs:
            _follow(page, runs[0], data)
        server.sleep_forever()
    finally:
        server.stop()


def _follow(page: Page, workdir: Path, data: Path | None):
    """Show what each new checkpoint of a run predicts, until Ctrl-C."""
    from dpc_jax.run.viewing.network_shapes import NetworkShapes  # and JAX: seconds

    network, busy, shown = NetworkShapes(workdir, data), threading.Lock(), None

    def predict(path):
        with busy:
            if shown is None:
                raise ValueError(
                    "Expected a checkpoint, but the run has none yet; try again later."
                )
            return network.show_images([path])

    page.add_upload(predict)
    while True:
        step = network.find_step()
        if step is None:
            page.say("Waiting for the first checkpoint of the run.")
        elif step != shown:
            page.say(f"Reading the network of step {step:,}.")
            try:
                with busy:
                    network.load()
                    found = network.show_validation()
            except (OSError, ValueError) as error:
                page.say(describe_error(error))
            else:
                page.show(found)
                page.say(
                    f"Step {step:,} of {network.config.train.steps:,}, validation."
                )
            shown = step
        time.sleep(_SECONDS)
