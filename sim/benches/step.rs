//! One servo period (4.5 ms) of the world, with read and write of its channel drivers; and of the engine alone, which moves the
//! same arms as multibodies of its own, in the same steps, with neither forms nor drivers.

use std::{sync::Arc, time::Duration};

use ctos::diagnostic::Source;
use divan::Bencher;
use mcs::{
    driver::{ChannelDriver, Power, SlotReading},
    model::{JointKind, Model},
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rapier3d_f64::{
    dynamics::{GenericJointBuilder, JointAxesMask, MassProperties, RigidBodyBuilder},
    math::{Matrix, Pose, Rotation, Vector},
    pipeline::PhysicsWorld,
};
use sim::{cell::Cell, driver::SimArm, port::Port, simulation::Simulation};

fn main() {
    divan::main();
}

const PERIOD: Duration = Duration::from_micros(4500);

/// An arm on its own, and the two of CIRSSE's testbed.
const CELLS: [&str; 2] = [
    "[[arm]]\nname = 'one'\nmodel = 'puma560'\nstart = [0, 45, -90, 0, 45, 0]\n",
    "[[arm]]\nname = 'left'\nmodel = 'testbed9'\nstart = [0, 0, 0, 0, 45, -90, 0, 45, 0]\n\
     [[arm]]\nname = 'right'\nmodel = 'testbed9'\nbase = { xyz = [0, 1.2, 0] }\nstart = [0, 0, 0, 0, 45, -90, 0, 45, 0]\n",
];

#[divan::bench(args = [(0, Power::Released), (0, Power::Braked), (1, Power::Released)])]
fn servo_period(bencher: Bencher, (cell, power): (usize, Power)) {
    let Ok(cell) = Cell::parse(&Source::new("cell.toml", CELLS[cell])) else {
        return;
    };
    let port = Arc::new(Port::new(&cell));
    let mut simulation = Simulation::new(&cell, Arc::clone(&port));
    let mut arms = Vec::new();
    for (index, arm) in cell.arms.iter().enumerate() {
        let joints: Vec<usize> = (0..arm.start.len()).collect();
        let driver = SimArm::new(&arm.name, ("world", &port, &cell), index, &joints);
        arms.extend(driver.map(|driver| (driver, arm.start.clone())));
    }
    bencher.bench_local(|| {
        for (arm, start) in &mut arms {
            let mut readings = vec![SlotReading::default(); start.len()];
            let _ = arm.read(&mut readings);
            // A soft hold keeps the arm in mid-range however long this runs.
            let hold = start.iter().zip(&readings);
            let torques: Vec<f64> = hold
                .map(|(start, at)| 400.0 * (start - at.position) - 40.0 * at.velocity)
                .collect();
            let _ = arm.write(&torques, power, PERIOD);
        }
        simulation.tick(PERIOD, 0, Duration::ZERO)
    });
}

fn pose(isometry: &Isometry3<f64>) -> Pose {
    let (t, r) = (isometry.translation, isometry.rotation);
    let turn = Rotation::from_xyzw(r.i, r.j, r.k, r.w);
    Pose::from_parts(Vector::new(t.x, t.y, t.z), turn)
}

/// Adds an arm as a multibody on a fixed body of its own. Joints are damped, so that they stay slow however long this runs.
fn insert(world: &mut PhysicsWorld, model: &Model) {
    // The engine's joints move about and along x.
    let x_along_z = UnitQuaternion::rotation_between(&Vector3::x(), &Vector3::z());
    let Some(turn) = x_along_z else { return };
    let turn = Isometry3::from_parts(Vector3::zeros().into(), turn);
    let root = world.insert_body(RigidBodyBuilder::fixed());
    let (mut bodies, mut last) = (Vec::new(), None);
    for joint in model.joints() {
        let (body, inertia) = (&joint.body, &joint.body.inertia);
        let [x, y, z] = body.centre.into();
        let properties = MassProperties::with_inertia_matrix(
            Vector::new(x, y, z),
            body.mass,
            Matrix::from_cols_array(&<[f64; 9]>::try_from(inertia.as_slice()).unwrap_or_default()),
        );
        let body = RigidBodyBuilder::dynamic().additional_mass_properties(properties);
        let body = world.insert_body(body.can_sleep(false));
        let axes = match joint.kind {
            JointKind::Revolute => JointAxesMask::LOCKED_REVOLUTE_AXES,
            JointKind::Prismatic => JointAxesMask::LOCKED_PRISMATIC_AXES,
        };
        let between = GenericJointBuilder::new(axes)
            .local_frame1(pose(&(joint.placement.isometry() * turn)))
            .local_frame2(pose(&turn));
        let parent = joint.parent.and_then(|parent| bodies.get(parent));
        let parent = parent.copied().unwrap_or(root);
        last = world.insert_multibody_joint(parent, body, between);
        bodies.push(body);
    }
    let multibody = last.and_then(|last| world.multibody_joints.get_mut(last));
    if let Some((multibody, _)) = multibody {
        multibody.forward_kinematics(&world.bodies, true);
        for (index, joint) in model.joints().iter().enumerate() {
            multibody.armature_mut()[index] = joint.motor.reflected_inertia();
            multibody.damping_mut()[index] = 500.0;
        }
    }
}

/// With so many substeps of each of three steps.
#[divan::bench(args = [1, 4])]
fn bare_engine_two_times_nine(bencher: Bencher, substeps: usize) {
    let Ok(cell) = Cell::parse(&Source::new("cell.toml", CELLS[1])) else {
        return;
    };
    let mut world = PhysicsWorld::new();
    world.gravity = Vector::new(0.0, 0.0, -9.81);
    world.integration_parameters.dt = 1.5e-3;
    world.integration_parameters.num_solver_iterations = substeps;
    for arm in &cell.arms {
        insert(&mut world, &arm.model);
    }
    bencher.bench_local(|| {
        for _ in 0..3 {
            world.step();
        }
        world.bodies.len()
    });
}
