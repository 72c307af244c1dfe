use super::*;
use crate::controls::surroundings::distance_to;
use foresight_scheduler::lod_tree::Aabb;
use proptest::prelude::*;

/// A cube of 10 m on hilly ground that is 3 sin(x/20) high; `up` is z.
struct Hills {
    has_ground: bool,
}

const CUBE: Aabb = Aabb { min: DVec3::new(-5.0, -5.0, 0.0), max: DVec3::new(5.0, 5.0, 10.0) };

impl Surroundings for Hills {
    fn up(&self) -> DVec3 {
        DVec3::Z
    }
    fn ground(&self, at: DVec3) -> Option<f64> {
        self.has_ground.then(|| 3.0 * libm::sin(at.x / 20.0))
    }
    fn nearest(&self, at: DVec3) -> f64 {
        distance_to(CUBE, at).max(0.5)
    }
    fn ahead(&self, from: DVec3, along: DVec3) -> Option<f64> {
        crate::controls::surroundings::along_ray(CUBE, from, along)
    }
    fn bounds(&self) -> Aabb {
        Aabb { min: DVec3::splat(-500.0), max: DVec3::splat(500.0) }
    }
}

const HILLS: Hills = Hills { has_ground: true };

fn looking(position: DVec3, yaw: f64, pitch: f64, mode: Mode) -> Rig {
    let forward = direction(DVec3::Z, yaw, pitch);
    let right = forward.cross(DVec3::Z).normalize();
    let orientation = DQuat::from_mat3(&DMat3::from_cols(right, right.cross(forward), -forward));
    Rig::at(&View { position, orientation, fov_y: 1.0, viewport: [4, 3] }, mode, &HILLS)
}

fn pose(rig: &Rig) -> View {
    rig.view(&HILLS, 1.0, [4, 3])
}

#[test]
fn the_view_is_where_the_angles_say() {
    let view = pose(&looking(DVec3::new(1.0, 2.0, 3.0), 0.7, -0.4, Mode::Fly));
    let forward = DVec3::new(libm::cos(0.7) * libm::cos(0.4), libm::sin(0.7) * libm::cos(0.4), -libm::sin(0.4));
    assert!((view.forward() - forward).length() < 1e-12);
    // Level: the camera's right has no part along up.
    assert!((view.orientation * DVec3::X).z.abs() < 1e-12 && (view.orientation * DVec3::Y).z > 0.0);
    // Turning by π/2 to the right looks along the former right.
    let mut rig = looking(DVec3::ZERO, 0.0, 0.0, Mode::Fly);
    let right = pose(&rig).orientation * DVec3::X;
    rig.step(&Input { dragged: [core::f64::consts::FRAC_PI_2, 0.0], ..Input::default() }, 0.0, &HILLS);
    assert!((pose(&rig).forward() - right).length() < 1e-12);
}

#[test]
fn flying_is_faster_far_from_things_and_stops_after_the_lag() {
    let push = Input { forward: 1.0, ..Input::default() };
    let mut far = looking(DVec3::new(205.0, 0.0, 5.0), 0.0, 0.0, Mode::Fly);
    let mut near = looking(DVec3::new(7.0, 0.0, 5.0), 0.0, 0.0, Mode::Fly);
    far.step(&push, 0.1, &HILLS);
    near.step(&push, 0.1, &HILLS);
    // u = 0.8·d; v = u(1 − e^(−dt/τ)).
    let share = 1.0 - libm::exp(-0.1 / LAG_S);
    assert!((far.speed() - 160.0 * share).abs() < 1e-9 && (near.speed() - 1.6 * share).abs() < 1e-9);
    assert!((far.position.x - 205.0 - (16.0 - 160.0 * LAG_S * share)).abs() < 1e-9);
    for _ in 0..200 {
        near.step(&Input::default(), 0.016, &HILLS);
    }
    assert_eq!(near.speed(), 0.0);
}

#[test]
fn who_walks_stays_on_the_ground() {
    let mut rig = looking(DVec3::new(30.0, -40.0, 90.0), 0.4, 0.5, Mode::Walk);
    let push = Input { forward: 1.0, up: 1.0, fast: true, ..Input::default() };
    for _ in 0..600 {
        rig.step(&push, 1.0 / 60.0, &HILLS);
        assert!((rig.position.z - 3.0 * libm::sin(rig.position.x / 20.0) - EYES).abs() < 1e-9);
    }
    // 10 s at 8 m/s along the level heading, less the lag.
    let walked = (rig.position - DVec3::new(30.0, -40.0, 0.0)).truncate().length();
    assert!((walked - (80.0 - 8.0 * LAG_S)).abs() < 1e-6, "{walked}");
    // From far outside to the edge of the world.
    let outside = looking(DVec3::new(900.0, -40.0, 700.0), 0.4, -0.5, Mode::Walk);
    let edge = DVec3::new(500.0, -40.0, 3.0 * libm::sin(25.0) + EYES);
    assert!((outside.position - edge).length() < 1e-9, "{}", outside.position);
    let space = Hills { has_ground: false };
    let mut rig = Rig::at(&pose(&looking(DVec3::new(100.0, 0.0, 50.0), 0.0, 0.0, Mode::Fly)), Mode::Walk, &space);
    assert!(rig.is_groundless());
    rig.step(&Input { up: 1.0, ..Input::default() }, 0.2, &space);
    assert!(rig.position.z > 50.0);
}

#[test]
fn an_orbit_keeps_its_pivot_in_the_middle() {
    // Looks at the cube along −x, from 45 m before its face.
    let mut rig = looking(DVec3::new(50.0, 0.0, 5.0), core::f64::consts::PI, 0.0, Mode::Orbit);
    let pivot = rig.pivot();
    assert!((pivot - DVec3::new(5.0, 0.0, 5.0)).length() < 1e-9);
    let distance = rig.position.distance(pivot);
    for i in 0..300 {
        let drag = if i % 2 == 0 { [0.05, 0.03] } else { [0.02, -0.01] };
        rig.step(&Input { right: 1.0, dragged: drag, ..Input::default() }, 1.0 / 60.0, &HILLS);
        let view = pose(&rig);
        assert!((view.position.distance(pivot) - distance).abs() < 1e-9);
        assert!((view.forward() - (pivot - view.position).normalize()).length() < 1e-9);
    }
    rig.step(&Input { wheel: 1.0, ..Input::default() }, 0.0, &HILLS);
    assert!((rig.position.distance(pivot) - distance / 1.15).abs() < 1e-9);
    // Where nothing is ahead the world's middle is orbited.
    let away = looking(DVec3::new(50.0, 0.0, 5.0), 0.0, 0.0, Mode::Orbit);
    assert!(away.pivot().length() < 1e-9 && pose(&away).forward().x < 0.0);
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -2.0..2.0, 1 => any::<f64>()]
}

prop_compose! {
    fn inputs()(n in prop::array::uniform8(any_number()), fast: bool) -> Input {
        let [forward, right, up, turn, tilt, x, y, wheel] = n;
        Input { forward, right, up, turn, tilt, dragged: [x, y], wheel, fast }
    }
}

proptest! {
    #[test]
    fn no_input_rolls_the_camera_or_loses_it(
        steps in prop::collection::vec((inputs(), any_number()), 1..40),
        mode in prop::sample::select(vec![Mode::Fly, Mode::Walk, Mode::Orbit]),
    ) {
        let mut rig = looking(DVec3::new(60.0, 10.0, 20.0), 2.0, 0.3, mode);
        for (input, dt) in steps {
            rig.step(&input, dt, &HILLS);
            let view = pose(&rig);
            prop_assert!(view.check().is_ok());
            prop_assert!((view.orientation * DVec3::X).z.abs() < 1e-9);
            prop_assert!((view.orientation * DVec3::Y).z > 0.0);
            prop_assert!(view.position.length() <= 20.1 * 1000.0 * 3.0_f64.sqrt());
        }
    }

    #[test]
    fn it_does_not_matter_how_a_time_is_cut(cuts in prop::collection::vec(0.001..0.01, 1..20)) {
        let push = Input { forward: 1.0, right: -0.3, ..Input::default() };
        let whole: f64 = cuts.iter().sum();
        let start = looking(DVec3::new(30.0, 0.0, 90.0), 0.4, 0.0, Mode::Walk);
        let (mut once, mut often) = (start, start);
        once.step(&push, whole, &HILLS);
        cuts.iter().for_each(|&dt| often.step(&push, dt, &HILLS));
        prop_assert!((once.position - often.position).truncate().length() < 1e-9);
    }
}
