"""`carrl.load_policy`: exported policies from Python."""

import zipfile

import numpy as np
import pytest

import carrl
from carrl.errors import CarrlError, ConfigError
from tests.export.policies import Exports


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    return Exports(tmp_path_factory.mktemp("exports"))


def test_one_car_is_driven_as_it_is_among_many(exports):
    policy = carrl.load_policy(exports.file("smooth", "npz"))
    inputs = exports.inputs("smooth", 4)
    many = policy(**inputs)
    one = policy(**{name: values[2].tolist() for name, values in inputs.items()})
    assert one["action"] == many["action"][2] and one["controls"].shape == (1,)
    np.testing.assert_allclose(one["action_value"], many["action_value"][2], rtol=1e-6)


@pytest.mark.parametrize(
    ("inputs", "says"),
    [
        ({"rays": [1.0] * 7}, "the policy's inputs are rays, last_action, not rays"),
        ({"rays": [1.0] * 6, "last_action": 0}, r"input rays is .* the shape \[6\]; it must be .* shape \[7\]"),
        ({"rays": [[1.0] * 7, [1.0]], "last_action": 0}, "input rays is no array; its rows must be of one length"),
        ({"rays": ["a"] * 7, "last_action": 0}, "input rays is <U1"),
        ({"rays": [1.0] * 7, "last_action": 3}, "input last_action is 3; actions are 0 to 2"),
        ({"rays": [1.0] * 7, "last_action": 0.5}, "input last_action is 0.5; actions are 0 to 2"),
        ({"rays": [[1.0] * 7] * 2, "last_action": [0]}, r"last_action is .* shape \[1\]; it must be .* \[2\]"),
    ],
)
def test_inputs_that_cannot_be_are_refused(exports, inputs, says):
    with pytest.raises(ConfigError, match=says):
        carrl.load_policy(exports.file("smooth", "npz"))(**inputs)


def test_a_driver_starts_anew_after_a_reset(exports):
    driver = carrl.load_policy(exports.file("f1tenth", "npz")).driver()
    first, second = (np.full(20, distance, np.float32) for distance in (2.0, 5.0))
    fresh = driver(rays=second, speed=3.0)["action"]
    driver(rays=first, speed=3.0)
    assert not np.allclose(driver(rays=second, speed=3.0)["action"], fresh)
    driver.reset()
    np.testing.assert_array_equal(driver(rays=second, speed=3.0)["action"], fresh)


def test_a_driver_takes_earlier_scans_and_forgets_what_was_refused(exports):
    policy = carrl.load_policy(exports.file("f1tenth", "npz"))
    driver, fresh = policy.driver(), policy.driver()
    rays = np.full(20, 2.0, np.float32)
    for refused in ({"rays": 2.0, "speed": 3.0}, {"rays": [2.0] * 21, "speed": 3.0}, {"rays": rays, "speed": np.nan}):
        with pytest.raises(ConfigError, match=r"input (rays|speed) is"):
            driver(**refused)
    np.testing.assert_array_equal(driver(rays=rays, speed=3.0)["action"], fresh(rays=rays, speed=3.0)["action"])
    shape = next(each["shape"] for each in policy.metadata["inputs"] if each["name"] == "previous_rays")
    given = policy.driver()(rays=rays, previous_rays=np.full(shape, 2.0), speed=3.0)
    np.testing.assert_array_equal(given["action"], policy.driver()(rays=rays, speed=3.0)["action"])


@pytest.mark.parametrize("speed", [np.nan, 1e300])
def test_inputs_but_rays_must_be_finite(exports, speed):
    with pytest.raises(ConfigError, match=r"input speed is .*; it must be finite"):
        carrl.load_policy(exports.file("f1tenth", "npz")).driver()(rays=[np.nan] * 20, speed=speed)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("policy.h", b"", "is a C header, which is compiled"),
        ("policy.pt", b"", "it must end in .onnx, .pt2, .npz"),
        ("policy.npz", b"damaged", "is damaged or not written by carrl export"),
        ("policy.onnx", b"damaged", "is damaged or not written by carrl export"),
        ("policy.pt2", b"damaged", "is damaged or not written by carrl export"),
    ],
)
def test_what_is_no_exported_policy_is_refused(name, content, says, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CarrlError, match=says):
        carrl.load_policy(tmp_path / name)
    with pytest.raises(CarrlError, match="cannot be read"):
        carrl.load_policy(tmp_path / "missing.npz")


def test_an_archive_that_unpacks_to_too_much_or_holds_pickles_is_refused(tmp_path):
    np.savez(tmp_path / "pickles.npz", metadata=np.array([{}], dtype=object))
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("metadata.npy", b"0")
        archive.infolist()[0].file_size = 2**40
    for name in ("pickles.npz", "bomb.npz"):
        with pytest.raises(CarrlError, match="is damaged or not written by carrl export"):
            carrl.load_policy(tmp_path / name)
