"""The directive ``replay``: a scene, simulated by the build, replayed in a frame of the page."""

import hashlib
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive, directives

ROOT = Path(__file__).parent.parent.parent


class Replay(Directive):
    """Simulate a scene, write its replay beside the page, and show it when it comes into sight."""

    required_arguments = 1  # the scene, from the root of the checkout
    option_spec: ClassVar = {
        "speed": float,
        "duration": float,
        "height": directives.unchanged,
        "folded": directives.flag,  # loaded when it is opened: a page can have many
    }

    def run(self):
        """The frame."""
        import multiarm as ma

        environment = self.state.document.settings.env
        scene = ROOT / self.arguments[0]
        environment.note_dependency(str(scene))
        name = f"{scene.stem}-{hashlib.sha1(repr(self.options).encode()).hexdigest()[:6]}.html"
        folder = Path(environment.app.outdir) / "_replays"
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / name).exists():
            system = ma.compile_system(ma.load_scene(scene))
            run = ma.simulate(system, self.options.get("duration"), certificate=False)
            if run.status != "completed":
                raise self.severe(f"{scene.name}: {run.status}, {run.message}")
            ma.replay(run, folder / name, speed=self.options.get("speed", 1.0))
        up = "../" * environment.docname.count("/")
        height = self.options.get("height", "480px")
        frame = (
            f'<iframe class="replay" src="{up}_replays/{name}" loading="lazy" '
            f'style="height:{height}" title="Replay of {scene.stem}"></iframe>'
        )
        if "folded" in self.options:
            # Loaded when it is opened: a page in a hidden frame has no size to fit its camera to.
            frame = frame.replace(" src=", " data-src=")
            opened = "const f = this.lastChild; f.src = this.open ? f.dataset.src : ''"
            frame = (
                f'<details class="replay" ontoggle="{opened}"><summary>Show the replay</summary>'
                f"{frame}</details>"
            )
        return [nodes.raw("", frame, format="html")]


def setup(app):
    """Register the directive."""
    app.add_directive("replay", Replay)
    return {"parallel_read_safe": False}
