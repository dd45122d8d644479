"""Which two cameras' pictures were exchanged is said only where one pair alone explains the shot."""

from types import SimpleNamespace

import pytest

from trinoc.calib.shots import exchanged


@pytest.mark.parametrize(
    ("explaining", "expected"),
    [([], None), ([(0, 2)], (0, 2)), ([(0, 1), (1, 2)], None), ([(0, 1), (0, 2), (1, 2)], None)],
)
def test_two_explanations_are_none(monkeypatch, explaining, expected) -> None:
    size = SimpleNamespace(image_size_px=(640, 480))
    cameras = [SimpleNamespace(camera=k, detections=[size], held_by=k) for k in range(3)]

    def through(owner, other, target):
        return SimpleNamespace(camera=owner.camera, detections=[size], held_by=other.camera)

    def placed(trial, cam_from_rig, target):
        moved = tuple(s.camera for s in trial if s.held_by != s.camera)
        return SimpleNamespace(stragglers=() if moved in explaining else (0,))

    monkeypatch.setattr(exchanged, "_through", through)
    monkeypatch.setattr(exchanged, "placed_shot", placed)
    assert exchanged.exchanged_pair(cameras, {}, None) == expected  # pyright: ignore
