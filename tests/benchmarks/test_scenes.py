import pytest

from benchmarks.scenes import BY_CONSTANTS, BY_PROPERTY, drawn, encoded


@pytest.mark.parametrize("saving", ["", *BY_CONSTANTS])
def test_scene_reaches_the_psnr_without_any_saving(saving: str) -> None:
    file, _ = encoded(drawn()["gradient"][::4, ::4], 30, saving)
    assert file.stats.psnr >= 30


def test_saving_that_is_refused_is_not_made() -> None:
    scenes = {"no Gaussians for a single colour": "one colour", "no chroma for grey": "text"}
    assert scenes.keys() == BY_PROPERTY.keys()
    for saving, scene in scenes.items():
        pixels = drawn()[scene][::4, ::4]
        usual, refused = (encoded(pixels, 24, one)[0].stats for one in ("", saving))
        assert (refused.steps, refused.bytes) > (usual.steps, usual.bytes)
