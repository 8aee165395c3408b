//! A model as a URDF text, which this program and others read.
//!
//! A link of a URDF has the frame of the joint that carries it. So each moving joint has a link of its own, which holds the
//! joint's body and the form of all that it carries, and the model's frames are links that are fixed to it. A form is a
//! `<collision>`: boxes, spheres and the capsules of URDF 1.2. What URDF has no word for is lost: limits of acceleration and jerk, Coulomb friction that differs by direction (the mean is written), and gravity. The inertia of a
//! rotor stands as `rotorInertia` in the joint's `<transmission>`; others pass over it.

use std::fmt::Write as _;

use nalgebra::Matrix3;

use super::UNLIMITED;
use crate::features::{Body, Joint, JointKind, Limits, Model};
use crate::placement::Placement;
use crate::shapes::Solid;

/// Two frames so near are one, m and parts of a direction.
const SAME: f64 = 1e-12;

/// A joint that slides and has no limit has this one, m: URDF asks for one.
const FAR: f64 = 1e6;

/// The model as a URDF text. A frame whose place is that of the next joint carries it, so that links follow one another as
/// in the model.
#[must_use]
pub fn write(model: &Model) -> String {
    let mut text = String::new();
    let out = &mut text;
    let bodies = body_links(model);
    line(out, format_args!("<?xml version=\"1.0\"?>"));
    line(
        out,
        format_args!("<robot name=\"{}\">", Escaped(model.name())),
    );
    for frame in model.frames() {
        if !bodies.contains(&frame.name) {
            // What stands on the ground is the base's form; the base is a link of its own.
            let carrier = (frame.parent.is_none()).then_some(None);
            write_link(out, &Body::default(), &frame.name, (model, carrier));
        }
    }
    for (index, (joint, link)) in model.joints().iter().zip(&bodies).enumerate() {
        write_link(out, &joint.body, link, (model, Some(Some(index))));
    }
    for (joint, link) in model.joints().iter().zip(&bodies) {
        let (parent, origin) = parent_of(model, joint, &bodies);
        write_joint(out, joint, (parent, &origin), link);
    }
    // The base frame is the first, and nothing carries it.
    for frame in model.frames().iter().skip(1) {
        if bodies.contains(&frame.name) {
            continue;
        }
        let parent = link_of(model, frame.carrier, &bodies);
        let name = Escaped(&frame.name);
        line(
            out,
            format_args!("  <joint name=\"{name}_fixed\" type=\"fixed\">"),
        );
        write_ends(out, (parent, &frame.placement), &frame.name);
        line(out, format_args!("  </joint>"));
    }
    for joint in model.joints() {
        write_motor(out, joint);
    }
    line(out, format_args!("</robot>"));
    text
}

/// The link of each joint's body: a frame that stands where the joint's own does, or one more link.
fn body_links(model: &Model) -> Vec<String> {
    let identity = Placement::identity();
    let own = |(index, joint): (usize, &Joint)| {
        let mut frames = model.frames().iter();
        let same = frames
            .find(|frame| frame.carrier == Some(index) && are_same(&frame.placement, &identity));
        if let Some(frame) = same {
            return frame.name.clone();
        }
        let mut name = format!("{}_body", joint.name);
        while model.frame(&name).is_some() {
            name.push('_');
        }
        name
    };
    model.joints().iter().enumerate().map(own).collect()
}

/// The link that holds what a joint carries, or the base.
fn link_of<'m>(model: &'m Model, carrier: Option<usize>, bodies: &'m [String]) -> &'m str {
    let body = carrier.and_then(|carrier| bodies.get(carrier));
    let base = model
        .frames()
        .first()
        .map_or("base", |base| base.name.as_str());
    body.map_or(base, String::as_str)
}

/// The link on which a joint stands, and where.
fn parent_of<'m>(model: &'m Model, joint: &Joint, bodies: &'m [String]) -> (&'m str, Placement) {
    let mut frames = model.frames().iter();
    let same = frames.find(|frame| {
        frame.carrier == joint.parent && are_same(&frame.placement, &joint.placement)
    });
    match same {
        Some(frame) => (&frame.name, Placement::identity()),
        None => (link_of(model, joint.parent, bodies), joint.placement),
    }
}

fn are_same(one: &Placement, other: &Placement) -> bool {
    (one.origin - other.origin).amax() <= SAME && (one.rotation - other.rotation).amax() <= SAME
}

/// A link with its body, and with the form of all that `carrier` carries.
fn write_link(
    out: &mut String,
    body: &Body,
    link: &str,
    (model, carrier): (&Model, Option<Option<usize>>),
) {
    let shapes = model.shapes().iter();
    let own = shapes.filter(|shape| Some(shape.carrier) == carrier);
    let form: Vec<&Solid> = own.map(|shape| &shape.solid).collect();
    if body.is_nothing() && form.is_empty() {
        return line(out, format_args!("  <link name=\"{}\"/>", Escaped(link)));
    }
    line(out, format_args!("  <link name=\"{}\">", Escaped(link)));
    if !body.is_nothing() {
        write_body(out, body);
    }
    for solid in form {
        write_solid(out, solid);
    }
    line(out, format_args!("  </link>"));
}

fn write_body(out: &mut String, body: &Body) {
    let ([x, y, z], i) = (<[f64; 3]>::from(body.centre), &body.inertia);
    line(out, format_args!("    <inertial>"));
    line(
        out,
        format_args!("      <origin xyz=\"{x:?} {y:?} {z:?}\" rpy=\"0 0 0\"/>"),
    );
    line(out, format_args!("      <mass value=\"{:?}\"/>", body.mass));
    line(
        out,
        format_args!(
            "      <inertia ixx=\"{:?}\" ixy=\"{:?}\" ixz=\"{:?}\" iyy=\"{:?}\" iyz=\"{:?}\" izz=\"{:?}\"/>",
            i.m11, i.m12, i.m13, i.m22, i.m23, i.m33
        ),
    );
    line(out, format_args!("    </inertial>"));
}

fn write_solid(out: &mut String, solid: &Solid) {
    let (at, form) = match solid {
        Solid::Capsule { a, b, radius } => {
            let (way, origin) = (b - a, (a + b) * 0.5);
            let length = way.norm();
            let at = match length > 0.0 {
                true => Placement {
                    origin,
                    ..Placement::along(&way)
                },
                false => Placement::shifted(origin.x, origin.y, origin.z),
            };
            let form = match length > 0.0 {
                true => format!("<capsule radius=\"{radius:?}\" length=\"{length:?}\"/>"),
                false => format!("<sphere radius=\"{radius:?}\"/>"),
            };
            (at, form)
        }
        Solid::Block { at, half } => {
            let [x, y, z] = (half * 2.0).into();
            (*at, format!("<box size=\"{x:?} {y:?} {z:?}\"/>"))
        }
        // A mesh stands in a file of its own: what is written is the box around it.
        Solid::Hull { at, hull } => {
            let [x, y, z] = (hull.half() * 2.0).into();
            (*at, format!("<box size=\"{x:?} {y:?} {z:?}\"/>"))
        }
    };
    line(out, format_args!("    <collision>"));
    write_origin(out, "      ", &at);
    line(out, format_args!("      <geometry>{form}</geometry>"));
    line(out, format_args!("    </collision>"));
}

fn write_joint(out: &mut String, joint: &Joint, parent: (&str, &Placement), link: &str) {
    let Limits {
        lower,
        upper,
        velocity,
        torque,
        ..
    } = joint.limits;
    let limited = lower.is_finite() && upper.is_finite();
    let kind = match joint.kind {
        JointKind::Prismatic => "prismatic",
        JointKind::Revolute if limited => "revolute",
        JointKind::Revolute => "continuous",
    };
    let name = Escaped(&joint.name);
    line(
        out,
        format_args!("  <joint name=\"{name}\" type=\"{kind}\">"),
    );
    write_ends(out, parent, link);
    line(out, format_args!("    <axis xyz=\"0 0 1\"/>"));
    let mut limit = String::new();
    if kind != "continuous" {
        let (lower, upper) = (lower.max(-FAR), upper.min(FAR));
        // Writing to a string never fails.
        let _ = write!(limit, " lower=\"{lower:?}\" upper=\"{upper:?}\"");
    }
    // Where there is a limit, URDF asks for both of these.
    if kind != "continuous" || velocity.is_finite() || torque.is_finite() {
        let [velocity, effort] = [velocity, torque].map(|most| most.min(UNLIMITED));
        line(
            out,
            format_args!("    <limit{limit} velocity=\"{velocity:?}\" effort=\"{effort:?}\"/>"),
        );
    }
    let (friction, gear) = (&joint.motor.friction, joint.motor.gear_ratio.abs());
    let viscous = gear * gear * friction.viscous;
    let coulomb = gear * (friction.coulomb_forward - friction.coulomb_backward) / 2.0;
    if viscous != 0.0 || coulomb != 0.0 {
        line(
            out,
            format_args!("    <dynamics damping=\"{viscous:?}\" friction=\"{coulomb:?}\"/>"),
        );
    }
    line(out, format_args!("  </joint>"));
}

fn write_ends(out: &mut String, (parent, origin): (&str, &Placement), child: &str) {
    write_origin(out, "    ", origin);
    line(
        out,
        format_args!("    <parent link=\"{}\"/>", Escaped(parent)),
    );
    line(
        out,
        format_args!("    <child link=\"{}\"/>", Escaped(child)),
    );
}

fn write_origin(out: &mut String, indent: &str, at: &Placement) {
    let [x, y, z] = at.origin.into();
    let [roll, pitch, yaw] = turns(&at.rotation);
    line(
        out,
        format_args!(
            "{indent}<origin xyz=\"{x:?} {y:?} {z:?}\" rpy=\"{roll:?} {pitch:?} {yaw:?}\"/>"
        ),
    );
}

fn write_motor(out: &mut String, joint: &Joint) {
    let (inertia, gear) = (joint.motor.rotor_inertia, joint.motor.gear_ratio);
    if inertia == 0.0 {
        return;
    }
    let name = Escaped(&joint.name);
    line(out, format_args!("  <transmission name=\"{name}_drive\">"));
    line(
        out,
        format_args!("    <type>transmission_interface/SimpleTransmission</type>"),
    );
    line(out, format_args!("    <joint name=\"{name}\"/>"));
    line(out, format_args!("    <actuator name=\"{name}_motor\">"));
    line(
        out,
        format_args!("      <mechanicalReduction>{gear:?}</mechanicalReduction>"),
    );
    line(
        out,
        format_args!("      <rotorInertia>{inertia:?}</rotorInertia>"),
    );
    line(out, format_args!("    </actuator>"));
    line(out, format_args!("  </transmission>"));
}

/// Roll, pitch and yaw of a rotation, rad, about the fixed axes x, y and z in turn. With the pitch at a quarter turn, where
/// roll and yaw are about one axis, still a way to the same rotation.
fn turns(rotation: &Matrix3<f64>) -> [f64; 3] {
    let r = rotation;
    let pitch = (-r.m31).atan2(r.m11.hypot(r.m21));
    let yaw = r.m21.atan2(r.m11);
    let (sin, cos) = yaw.sin_cos();
    let roll = (sin * r.m13 - cos * r.m23).atan2(cos * r.m22 - sin * r.m12);
    [roll, pitch, yaw]
}

/// A name within quotation marks.
struct Escaped<'n>(&'n str);

impl std::fmt::Display for Escaped<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for letter in self.0.chars() {
            match letter {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                letter => f.write_char(letter)?,
            }
        }
        Ok(())
    }
}

fn line(out: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a string never fails.
    let _ = writeln!(out, "{text}");
}
