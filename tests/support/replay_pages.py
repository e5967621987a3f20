"""A scene to replay, and the page of a replay as a browser shows it."""

from __future__ import annotations

SCENE = """
name: two arms swing <a beam>
gravity: [0, 0, -9.81]
object: {shape: {box: [0.8, 0.3, 0.2]}, mass: 6.0, pose: {xyz: [0, 0, 0.9]}}
arms:
  left: {robot: textbook_6r, base: {xyz: [-0.9, 0, 0.1]}, tip: tool, posture: POSTURE}
  right: {robot: textbook_6r, base: {xyz: [0.9, 0, 0.1], rpy: [0, 0, 3.141592653589793]},
          tip: tool, posture: POSTURE, color: "#336699"}
joints: [{arm: left, kind: ball}, {arm: right, kind: weld}]
run: {duration: 0.5, accuracy: 1.0e-5, output_step: 0.01}
""".replace("POSTURE", "[0.1, 0.4, 0.9, 0.0, 0.5, 0.0]")


SEEK = """(time) => {
  viewer.animator.pause();
  viewer.animator.seek(time);
  viewer.render();
}"""


POSE = """(path) => {
  const {position, quaternion} = viewer.scene_tree.find(path).object;
  return {position: position.toArray(), quaternion: quaternion.toArray()};
}"""


def opened(view, path):
    view.open(path.as_uri())
    view.page.wait_for_selector("body[data-ready]", timeout=60_000)
    return view.page
