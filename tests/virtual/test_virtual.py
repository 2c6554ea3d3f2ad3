"""Virtual instruments on analytic fields: what is written must be the field at the right place, plus the stated noise."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.ndimage import map_coordinates

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.experiment import CELSIUS, Specimen
from thermofit.observe.face import displacement_at, face_grid, invert_motion, locate
from thermofit.read.raw import read_experiment
from thermofit.study.section import Section
from thermofit.study.virtual import Machine, VirtualDic, VirtualForce, VirtualInstruments, VirtualIr
from thermofit.virtual import infrared as virtual_ir
from thermofit.virtual import laboratory as virtual
from thermofit.virtual.dic import measure_dic
from thermofit.virtual.infrared import background_field, camera_pose, pick_landmarks, to_pixel, to_space
from thermofit.virtual.laboratory import write_raw
from thermofit.virtual.machine import LoadHistory
from thermofit.virtual.setup import (
    STREAMS,
    VirtualFields,
    rigid_motion,
    sampling_times,
    solution_times,
    stream,
)

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
STILL = Machine(compliance=0.0, slip=0.0, rotation_deg=0.0, drift=0.0)
CLEAN = VirtualInstruments(
    machine=STILL,
    dic=VirtualDic(noise_in_plane=0.0, noise_out_of_plane=0.0, lost_fraction=0.0),
    ir=VirtualIr(netd=0.0, offset=0.0, blur_px=0.0, landmark_noise_px=0.0, image_shape=(120, 90)),
    force=VirtualForce(noise=0.0, crosshead_noise=0.0),
    thermocouple_error=0.0,
)
STRETCH_X, STRETCH_Y = 0.93, 1.16


def replaced(section: Section, **own: object) -> Section:
    return section.model_copy(update=own)


def face_nodes() -> np.ndarray:
    y = np.concatenate([np.linspace(-75, -50, 12)[:-1], np.linspace(-50, 50, 21), np.linspace(50, 75, 12)[1:]])
    s = np.clip(np.abs(y) - 50.0, 0.0, 15.0)
    half = 12.5 + 25.0 - np.sqrt(625.0 - s**2)
    nodes = np.stack([half[:, None] * np.linspace(0, 1, 5), np.repeat(y[:, None], 5, axis=1)], axis=-1).reshape(-1, 2)
    return np.random.default_rng(7).permutation(nodes)


def affine(face: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Displacement growing to diag(0.93, 1.16) - 1 and fixed at y = -75."""
    u = np.zeros((len(level), len(face), 3))
    u[..., 0] = level[:, None] * (STRETCH_X - 1.0) * face[:, 0]
    u[..., 1] = level[:, None] * (STRETCH_Y - 1.0) * (face[:, 1] + 75.0)
    u[..., 2] = -0.05 * level[:, None]
    return u


def make_fields(level: float = 1.0, n: int = 4, slip: float = 0.0) -> VirtualFields:
    face = face_nodes()
    time = np.linspace(0.0, 30.0, 301)
    force = 7000.0 * np.minimum(time / 20.0, 1.0)
    load = LoadHistory(time, force, 0.5 * time, slip * np.minimum(time / 20.0, 1.0), np.array([20.0]))
    dic, ir = np.linspace(0.0, 29.0, n), np.linspace(0.0, 29.5, n)
    theta = 296.0 + 0.03 * np.abs(face[:, 0]) + 0.02 * face[:, 1] + np.zeros((n, 1))
    u_dic, u_ir = affine(face, level * dic / 29.0), affine(face, level * ir / 29.5)
    return VirtualFields(SPECIMEN, load, 0.4 * time, face, dic, u_dic, ir, u_ir, theta, 297.4, 296.7, ("a", "b"))


def read_stage(folder: Path, k: int) -> np.ndarray:
    return np.loadtxt(folder / "dic" / f"stage_{k:04d}.csv", delimiter=",", skiprows=2)


def read_frame(folder: Path, k: int) -> np.ndarray:
    return np.loadtxt(folder / "ir" / f"frame_{k:04d}.csv", delimiter=",") + CELSIUS


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("virtual") / "raw"
    write_raw(folder, make_fields(), CLEAN, 3)
    return folder


def test_dic_returns_the_affine_field_on_the_whole_face(clean: Path) -> None:
    table = read_stage(clean, 3)
    assert (clean / "dic" / "stage_0003.csv").read_text().startswith("# time_s: 29.000\nid,x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm\n1,-11.")
    x, y = table[:, 1], table[:, 2]
    assert table[:, 4] == pytest.approx((STRETCH_X - 1.0) * x, abs=6e-6)
    assert table[:, 5] == pytest.approx((STRETCH_Y - 1.0) * (y + 75.0), abs=6e-6)
    assert table[:, 6] == pytest.approx(-0.05, abs=6e-6)
    assert table[:, 3] == pytest.approx(0.6)
    assert np.abs(x).max() <= 11.5 and np.abs(y).max() <= 25.0 and (x < -11.0).any() and (y > 24.5).any()
    assert np.abs(np.diff(np.sort(x)[::50])).min() > 0.0 and len(table) == 23 * 50


def test_dic_adds_the_rigid_body_motion() -> None:
    fields = make_fields(slip=0.3)
    machine = Machine(rotation_deg=2.0, drift=0.5)
    motion = rigid_motion(fields.load, machine, 5, fields.dic_time)
    stages = measure_dic(fields, face_grid(fields.face), motion, CLEAN.dic, 5)
    body = stages.reference + np.column_stack(
        [-0.07 * stages.reference[:, 0], 0.16 * (stages.reference[:, 1] + 75.0), np.full(len(stages.reference), -0.05)]
    )
    moved = stages.reference + stages.displacement[3]
    back = (moved - motion.shift[3]) @ motion.rotation[3]
    assert back == pytest.approx(body, abs=1e-9)
    # Half of compliance and slip moves the fixed end; nothing has moved before the load.
    assert motion.shift[3, 1] == pytest.approx(0.5 * (1e-4 * 7000.0 + 0.3))
    assert motion.shift[0] == pytest.approx(0.0) and motion.rotation[0] == pytest.approx(np.eye(3))
    assert np.linalg.det(motion.rotation[3]) == pytest.approx(1.0)
    assert 1.0 < np.rad2deg(np.arccos((np.trace(motion.rotation[3]) - 1.0) / 2.0)) < 5.0


def test_pixels_return_the_temperature_at_the_current_position(clean: Path) -> None:
    pose = camera_pose(CLEAN.ir, 3)
    space = to_space(pose, np.stack(np.indices((120, 90)), axis=-1).astype(float))
    background = background_field(CLEAN.ir, 3)
    for k, level in ((0, 0.0), (3, 1.0)):
        fx, fy = 1.0 + level * (STRETCH_X - 1.0), 1.0 + level * (STRETCH_Y - 1.0)
        x = space[..., 0] / fx
        y = (space[..., 1] - level * (STRETCH_Y - 1.0) * 75.0) / fy
        inside = np.abs(space[..., 0]) < 12.5 * fx - 0.3
        outside = np.abs(space[..., 0]) > 12.5 * fx + 0.3
        frame = read_frame(clean, k)
        assert inside.sum() > 5000 and outside.sum() > 2000
        assert frame[inside] == pytest.approx((296.0 + 0.03 * np.abs(x) + 0.02 * y)[inside], abs=6e-4)
        assert frame[outside] == pytest.approx(background[outside], abs=6e-4)


def test_pixels_follow_the_rigid_body_motion() -> None:
    """Forward: reference points go through deformation, motion and camera; the image there must be their temperature."""
    fields = make_fields(slip=0.3)
    fields = dataclasses.replace(fields, ir_theta=296.0 + 0.02 * fields.face[:, 1] + np.zeros((4, 1)))
    motion = rigid_motion(fields.load, Machine(rotation_deg=2.0, drift=0.5), 5, fields.ir_time)
    scene = virtual_ir.scene_of(fields, face_grid(fields.face), CLEAN.ir, 5)
    frame = virtual_ir.measure_infrared(fields, scene, motion, 5)[3]
    x, y = np.meshgrid(np.linspace(-9.0, 9.0, 7), np.linspace(-20.0, 3.0, 6))
    body = np.stack([STRETCH_X * x, STRETCH_Y * y + 0.16 * 75.0, np.full_like(x, -0.6)], axis=-1)
    pixel = to_pixel(camera_pose(CLEAN.ir, 5), (body @ motion.rotation[3].T + motion.shift[3])[..., :2])
    seen = map_coordinates(frame, np.moveaxis(pixel, -1, 0), order=1)
    assert seen == pytest.approx(296.0 + 0.02 * y, abs=1e-6)


def test_edges_are_mixed_by_area() -> None:
    fields = make_fields()
    ir = replaced(CLEAN.ir, background_spread=0.0, background=290.0)
    fields = dataclasses.replace(fields, ir_theta=np.full_like(fields.ir_theta, 300.0))
    grid = face_grid(fields.face)
    motion = rigid_motion(fields.load, Machine(rotation_deg=1.0), 3, fields.ir_time)
    scene = virtual_ir.scene_of(fields, grid, ir, 3)
    for k, stretch in ((0, 1.0), (3, STRETCH_X)):
        for blur in (0.0, 0.7):
            settings = dataclasses.replace(scene, settings=replaced(ir, blur_px=blur))
            frame = virtual_ir.measure_infrared(fields, settings, motion, 3)[k]
            width = (frame - 290.0).sum(axis=1) / 10.0 * ir.pixel_size
            # Across a row the width is seen under the roll of camera and specimen.
            assert width[10:-10].mean() == pytest.approx(25.0 * stretch, abs=0.03)
    mixed = (frame > 290.5) & (frame < 299.5)
    assert 2 * 120 <= mixed.sum() <= 10 * 120


def test_jaws_are_seen_at_their_own_temperature() -> None:
    fields = make_fields()
    ir = replaced(CLEAN.ir, image_shape=(440, 150))
    scene = virtual_ir.scene_of(fields, face_grid(fields.face), ir, 3)
    motion = rigid_motion(fields.load, STILL, 3, fields.ir_time)
    frames = virtual_ir.measure_infrared(fields, scene, motion, 3)
    pose = camera_pose(ir, 3)
    for k, top in ((0, 65.0), (3, 65.0 + 0.16 * 140.0)):
        # The lower mouth moves up by 1.6 mm, because the affine field strains the gripped end too.
        for y, is_jaw in ((top + 2.0, True), (top - 2.0, False), (-62.0, False), (-68.0, True)):
            row, column = np.round(to_pixel(pose, np.array([5.0, y]))).astype(int)
            assert (frames[k, row, column] == pytest.approx(296.7, abs=1e-9)) == is_jaw


def test_pose_is_a_mirrored_rolled_view_and_invertible() -> None:
    pose = camera_pose(VirtualIr(), 11)
    points = np.random.default_rng(0).uniform(-20, 20, (50, 2))
    assert to_space(pose, to_pixel(pose, points)) == pytest.approx(points, abs=1e-12)
    centre, up, plus_x = to_pixel(pose, np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 0.0]]))
    assert up[0] < centre[0] and plus_x[1] < centre[1]
    # Roll: the specimen axis leans clockwise, to the right at the top.
    assert np.rad2deg(np.arctan2(up[1] - centre[1], centre[0] - up[0])) == pytest.approx(1.1)


def test_landmarks_agree_with_the_pose() -> None:
    settings = VirtualIr(landmark_noise_px=0.0)
    pose = camera_pose(settings, 4)
    marks = pick_landmarks(pose, SPECIMEN, settings, 4)
    assert np.hypot(*(marks.length[1] - marks.length[0])) * 0.4 == pytest.approx(marks.length_mm, abs=0.05)
    a = np.column_stack([2.0 * marks.circle, np.ones(3)])
    centre = np.linalg.solve(a, (marks.circle**2).sum(axis=1))[:2]
    assert centre == pytest.approx(pose.centre, abs=0.15)
    left, right = to_space(pose, marks.edge_left), to_space(pose, marks.edge_right)
    assert left[:, 0] == pytest.approx(12.5, abs=0.03) and right[0] == pytest.approx(-12.5, abs=0.03)
    assert (marks.edge_left[:, 1] < marks.edge_right[1]).all()


def test_landmarks_carry_the_picking_error() -> None:
    pose = camera_pose(VirtualIr(), 4)
    exact = pick_landmarks(pose, SPECIMEN, VirtualIr(landmark_noise_px=0.0), 4)
    error = [pick_landmarks(pose, SPECIMEN, VirtualIr(), seed).circle - exact.circle for seed in range(200)]
    assert np.std(error) == pytest.approx(0.15, rel=0.12)


def test_image_too_small_for_the_specimen_is_refused() -> None:
    settings = VirtualIr(image_shape=(200, 50))
    with pytest.raises(StudyError, match="image_shape"):
        pick_landmarks(camera_pose(settings, 1), SPECIMEN, settings, 1)


def test_inverse_map_of_a_curved_field() -> None:
    grid = face_grid(face_nodes())
    y = grid.y[:, None]
    u = np.stack([-0.07 * grid.x * (1.0 + 0.2 * np.sin(y / 20.0)), 0.3 * (y + 75.0) + 2.0 * np.sin(y / 15.0) + 0.002 * grid.x**2], axis=-1)
    points = np.column_stack([np.random.default_rng(1).uniform(-12.0, 12.0, 400), np.random.default_rng(2).uniform(-50, 50, 400)])
    current = points + displacement_at(locate(grid, points), u)
    assert invert_motion(grid, u, current, current) == pytest.approx(points, abs=2e-6)


def test_folded_mesh_is_reported() -> None:
    grid = face_grid(face_nodes())
    u = np.stack([0.0 * grid.x, np.where(np.arange(len(grid.y)) % 2, 30.0, -30.0)[:, None] + 0.0 * grid.x], axis=-1)
    points = np.column_stack([np.zeros(50), np.linspace(-40, 40, 50)])
    with pytest.raises(NumericsError, match="traced back"):
        invert_motion(grid, u, points, points)


def test_faces_that_are_no_grid_are_refused() -> None:
    nodes = face_nodes()
    with pytest.raises(StudyError, match="rows"):
        face_grid(nodes[:-1])
    with pytest.raises(StudyError, match="quarter"):
        face_grid(nodes + np.array([1.0, 0.0]))


def test_force_file_and_description(clean: Path) -> None:
    lines = (clean / "force.csv").read_text().splitlines()
    assert lines[0] == "time_s,force_N,crosshead_mm" and lines[101] == "10.000,3500.00,4.0000" and len(lines) == 302
    text = yaml.safe_load((clean / "experiment.yaml").read_text())
    assert list(text) == ["specimen", "temperatures", "time", "force", "dic", "ir", "programme"]
    assert text["temperatures"]["theta_air_degC"] == pytest.approx(24.25) and text["programme"] == ["a", "b"]
    assert text["dic"]["stages"] == 4 and text["ir"]["frames"] == 4 and text["ir"]["image_shape"] == [120, 90]
    assert set(text["ir"]["landmarks"]) == {"length", "edge_left", "edge_right", "circle", "note"}
    assert not list(clean.rglob("truth*"))


def test_crosshead_contains_compliance_and_slip(tmp_path: Path) -> None:
    settings = replaced(CLEAN, machine=Machine(compliance=2e-4))
    write_raw(tmp_path / "raw", make_fields(slip=0.3), settings, 3)
    table = np.loadtxt(tmp_path / "raw" / "force.csv", delimiter=",", skiprows=1)
    assert table[-1, 2] == pytest.approx(0.4 * 30.0 + 2e-4 * 7000.0 + 0.3, abs=1e-4)


def test_streams_are_independent_of_each_other() -> None:
    first = np.array([stream(1, name).standard_normal(200) for name in STREAMS])
    assert np.abs(np.corrcoef(first) - np.eye(len(STREAMS))).max() < 0.3


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_one_seed_gives_the_same_bytes_and_instruments_do_not_disturb_each_other(tmp_path: Path) -> None:
    fields = make_fields(n=3)
    noisy = VirtualInstruments(ir=VirtualIr(image_shape=(80, 90)))
    other = replaced(noisy, dic=VirtualDic(noise_in_plane=0.004, spacing=2.0))
    files = []
    for name, settings, seed in (("a", noisy, 1), ("b", noisy, 1), ("c", other, 1), ("d", noisy, 2)):
        write_raw(tmp_path / name, fields, settings, seed)
        files.append(contents(tmp_path / name))
    a, b, c, d = files
    assert a == b
    assert all((a[name] == c[name]) == (name[:3] not in ("dic", "exp")) for name in c)
    assert all(a[name] != d[name] for name in a)


def test_noise_has_the_stated_size_and_losses_are_counted(tmp_path: Path) -> None:
    fields = make_fields(level=0.0, n=10)
    fields = dataclasses.replace(fields, ir_theta=np.full_like(fields.ir_theta, 300.0))
    settings = VirtualInstruments(machine=STILL, ir=VirtualIr(image_shape=(80, 90)), dic=VirtualDic(lost_fraction=0.02))
    summary = write_raw(tmp_path / "raw", fields, settings, 9)
    tables = [read_stage(tmp_path / "raw", k) for k in range(10)]
    all_points = np.concatenate(tables)
    assert np.std(all_points[:, 4:6]) == pytest.approx(0.002, rel=0.03)
    assert np.std(all_points[:, 6]) == pytest.approx(0.005, rel=0.03)
    assert summary.counts["lost_points"] == 10 * summary.counts["points"] - len(all_points)
    assert 0.012 < summary.counts["lost_points"] / (10 * summary.counts["points"]) < 0.035
    known = {}
    for row in all_points:
        assert known.setdefault(int(row[0]), tuple(row[1:4])) == tuple(row[1:4])
    core = np.stack([read_frame(tmp_path / "raw", k) for k in range(10)])[:, 10:70, 25:65]
    assert core.mean() == pytest.approx(300.5, abs=1e-3) and core.std() == pytest.approx(0.025, rel=0.03)
    force = np.loadtxt(tmp_path / "raw" / "force.csv", delimiter=",", skiprows=1)[:, 1]
    assert np.std(force - np.interp(np.arange(301) / 10.0, fields.load.time, fields.load.force)) == pytest.approx(4.0, rel=0.15)


def test_sampling_times_are_dense_around_kinks_and_differ_between_instruments() -> None:
    kinks = np.array([3.0, 70.0, 77.0, 155.0, 165.0])
    dic, ir = (sampling_times(kinks, 400.0, n, stream(1, name)) for n, name in ((120, "dic.times"), (130, "ir.times")))
    for time, n in ((dic, 120), (ir, 130)):
        assert len(time) == n and time[0] == 0.0 and 395.0 < time[-1] <= 400.0
        step = np.diff(time)
        assert step.min() > 0.0 and np.unique(np.round(step, 3)).size > 0.8 * n

        def spacing(a: float, b: float, time: np.ndarray = time, step: np.ndarray = step) -> float:
            return float(np.median(step[(time[:-1] >= a) & (time[:-1] <= b)]))

        assert spacing(68, 80) < 0.6 * spacing(30, 55)
        assert spacing(165, 172) < spacing(190, 220) < spacing(300, 390)
    assert np.abs(np.subtract.outer(dic[1:], ir[1:])).min(axis=1).mean() > 0.1
    with pytest.raises(StudyError, match="samples"):
        sampling_times(kinks, 1.0, 2000, stream(1, "dic.times"))


def test_steps_are_short_while_the_force_changes_alone() -> None:
    """A rest of 40 s needs none of them."""
    time = np.linspace(0.0, 60.0, 601)
    load = LoadHistory(time, 350.0 * np.minimum(time, 20.0), time, 0.0 * time, np.array([20.0]))
    ends = np.array([0.0, 60.0])
    step, begin = (f(solution_times(load, ends, ends, 5.0, 0.5)) for f in (np.diff, lambda t: t[:-1]))
    assert step[begin < 19.9].max() <= 0.5 + 1e-9 and step[begin > 19.9] == pytest.approx(5.0)
    assert np.diff(solution_times(load, ends, ends, 5.0)) == pytest.approx(5.0)
    cycle = LoadHistory(time[:3], np.array([0.0, 9.0, 0.0]), time[:3], time[:3], np.zeros(0))
    assert cycle.changes(0.0, float(time[2])), "the same at both ends, and not between them"


def test_killed_run_leaves_the_old_folder_and_no_rubbish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fields, settings = make_fields(n=2), replaced(CLEAN, ir=replaced(CLEAN.ir, image_shape=(80, 90)))
    write_raw(tmp_path / "raw", fields, settings, 1)
    before = contents(tmp_path / "raw")

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(virtual, "write_infrared", killed)
        with pytest.raises(KeyboardInterrupt):
            write_raw(tmp_path / "raw", fields, settings, 2)
    assert contents(tmp_path / "raw") == before and [p.name for p in tmp_path.iterdir()] == ["raw"]
    write_raw(tmp_path / "raw", fields, replaced(settings, force=VirtualForce()), 2)
    assert contents(tmp_path / "raw") != before and [p.name for p in tmp_path.iterdir()] == ["raw"]


def test_foreign_folders_and_broken_fields_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("years of work")
    with pytest.raises(StudyError, match="left alone"):
        write_raw(tmp_path / "thesis", make_fields(n=2), CLEAN, 1)
    fields = make_fields(n=2)
    fields.ir_theta[0, 0] = np.nan
    with pytest.raises(NumericsError, match="ir_theta"):
        write_raw(tmp_path / "raw", fields, CLEAN, 1)
    with pytest.raises(ValueError, match="dic_u"):
        write_raw(tmp_path / "raw", dataclasses.replace(make_fields(n=2), dic_u=np.zeros((2, 3, 3))), CLEAN, 1)
    assert not (tmp_path / "raw").exists()


def test_read_back_by_the_reader_of_raw_experiments(clean: Path) -> None:
    experiment = read_experiment(clean)
    assert experiment.dic is not None and experiment.ir is not None and experiment.landmarks is not None
    assert experiment.specimen == SPECIMEN and experiment.theta_clamp == pytest.approx(296.7)
    assert experiment.dic.displacement.shape == (4, 1150, 3) and experiment.ir.frames.shape == (4, 120, 90)
    assert experiment.landmarks.circle.shape == (3, 2)
