//! Solids as primitives of `foxglove.SceneEntity`.

use foxglove::messages::{
    ArrowPrimitive, Color, CubePrimitive, CylinderPrimitive, LinePrimitive, Point3, Pose,
    Quaternion, SceneEntity, SpherePrimitive, TriangleListPrimitive, Vector3, line_primitive,
};
use scene::Solid;

pub(crate) fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

fn point(&[x, y, z]: &[f64; 3]) -> Point3 {
    Point3 { x, y, z }
}

pub(crate) fn quaternion([x, y, z, w]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}

pub(crate) fn pose(at: &scene::Pose) -> Pose {
    Pose {
        position: Some(vector(at.at)),
        orientation: Some(quaternion(at.turn)),
    }
}

pub(crate) fn colour([r, g, b]: [u8; 3], a: f64) -> Color {
    let part = |byte: u8| f64::from(byte) / 255.0;
    Color {
        r: part(r),
        g: part(g),
        b: part(b),
        a,
    }
}

/// The shortest turn of the axis `from` (x or z) to the direction of `to`; none for a direction of no length.
fn turn_to(from: [f64; 3], to: [f64; 3]) -> Option<[f64; 4]> {
    let length = to.iter().map(|part| part * part).sum::<f64>().sqrt();
    if length < 1e-12 {
        return None;
    }
    let [x, y, z] = to.map(|part| part / length);
    let [a, b, c] = from;
    let w = 1.0 + a * x + b * y + c * z;
    if w < 1e-9 {
        // Half a turn, about the y axis, which is square to both.
        return Some([0.0, 1.0, 0.0, 0.0]);
    }
    let turn = [b * z - c * y, c * x - a * z, a * y - b * x, w];
    let norm = turn.iter().map(|part| part * part).sum::<f64>().sqrt();
    Some(turn.map(|part| part / norm))
}

/// Adds `solid` to the entity of its part.
pub(crate) fn add(entity: &mut SceneEntity, solid: &Solid, fill: Color) {
    match solid {
        Solid::Capsule { a, b, radius } => {
            let along = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
            let ball = |at: &[f64; 3]| SpherePrimitive {
                pose: Some(Pose {
                    position: Some(vector(*at)),
                    orientation: Some(quaternion([0.0, 0.0, 0.0, 1.0])),
                }),
                size: Some(vector([2.0 * radius; 3])),
                color: Some(fill),
            };
            entity.spheres.push(ball(a));
            if let Some(turn) = turn_to([0.0, 0.0, 1.0], along) {
                entity.spheres.push(ball(b));
                let middle = [0, 1, 2].map(|axis| f64::midpoint(a[axis], b[axis]));
                let length = along.iter().map(|part| part * part).sum::<f64>().sqrt();
                let at = scene::Pose { at: middle, turn };
                entity.cylinders.push(cylinder(&at, *radius, length, fill));
            }
        }
        Solid::Block { pose: at, half } => entity.cubes.push(CubePrimitive {
            pose: Some(pose(at)),
            size: Some(vector(half.map(|half| 2.0 * half))),
            color: Some(fill),
        }),
        Solid::Cylinder {
            pose: at,
            half,
            radius,
        } => entity
            .cylinders
            .push(cylinder(at, *radius, 2.0 * half, fill)),
        Solid::Hull {
            pose: at,
            corners,
            triangles,
        } => entity.triangles.push(TriangleListPrimitive {
            pose: Some(pose(at)),
            points: corners.iter().map(point).collect(),
            color: Some(fill),
            colors: Vec::new(),
            indices: triangles.concat(),
        }),
        Solid::Axes(length) => {
            let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let colours = [[214, 69, 65], [76, 154, 42], [52, 101, 204]];
            for (axis, one) in axes.into_iter().zip(colours) {
                entity.arrows.push(arrow(axis, *length, colour(one, 1.0)));
            }
        }
        Solid::Frustum { corners, .. } => entity.lines.push(pyramid(corners, fill)),
        // It moves with the numbers of its part, which are told more often: see `add_vector`.
        Solid::Vector { .. } => {}
    }
}

/// Adds an arrow along `vector`, m.
pub(crate) fn add_vector(entity: &mut SceneEntity, vector: [f64; 3], fill: Color) {
    let length = vector.iter().map(|part| part * part).sum::<f64>().sqrt();
    if length > 1e-6 {
        entity.arrows.push(arrow(vector, length, fill));
    }
}

fn cylinder(at: &scene::Pose, radius: f64, height: f64, fill: Color) -> CylinderPrimitive {
    CylinderPrimitive {
        pose: Some(pose(at)),
        size: Some(vector([2.0 * radius, 2.0 * radius, height])),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(fill),
    }
}

/// Arrows point along x.
fn arrow(axis: [f64; 3], length: f64, fill: Color) -> ArrowPrimitive {
    let turn = turn_to([1.0, 0.0, 0.0], axis).unwrap_or([0.0, 0.0, 0.0, 1.0]);
    ArrowPrimitive {
        pose: Some(pose(&scene::Pose { at: [0.0; 3], turn })),
        shaft_length: 0.8 * length,
        shaft_diameter: 0.06 * length,
        head_length: 0.2 * length,
        head_diameter: 0.14 * length,
        color: Some(fill),
    }
}

fn pyramid(corners: &[[f64; 3]; 4], fill: Color) -> LinePrimitive {
    let next = corners.iter().cycle().skip(1);
    let edges = corners.iter().zip(next);
    let points = edges.flat_map(|(one, other)| [[0.0; 3], *one, *one, *other]);
    LinePrimitive {
        r#type: line_primitive::Type::LineList as i32,
        pose: Some(pose(&scene::Pose::default())),
        thickness: 1.5,
        scale_invariant: true,
        points: points.map(|at| point(&at)).collect(),
        color: Some(fill),
        colors: Vec::new(),
        indices: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Quaternion as Q, UnitQuaternion, Vector3 as V};

    use super::*;

    #[test]
    fn an_axis_turned_to_a_direction_points_there() {
        let directions = [
            [0.0, 0.0, 2.0],
            [0.0, 0.0, -3.0],
            [-1.0, 0.0, 0.0],
            [1.0, -2.0, 0.5],
            [1e-7, 0.0, -1.0],
        ];
        for from in [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]] {
            for to in directions {
                let [x, y, z, w] = turn_to(from, to).unwrap();
                let turn = UnitQuaternion::new_unchecked(Q::new(w, x, y, z));
                let turned = turn * V::from(from);
                let off = (turned - V::from(to).normalize()).norm();
                assert!(off < 1e-6, "{from:?} to {to:?}: {turned}");
            }
        }
        assert_eq!(turn_to([0.0, 0.0, 1.0], [0.0; 3]), None);
    }

    #[test]
    fn a_convex_body_is_the_list_of_its_triangles() {
        let corners = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]];
        let mut entity = SceneEntity::default();
        let solid = Solid::Hull {
            pose: scene::Pose::default(),
            corners,
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        };
        add(&mut entity, &solid, Color::default());
        let list = &entity.triangles[0];
        assert_eq!((list.points.len(), list.indices.len()), (4, 12));
        let [x, y, z] = [0, 1, 2].map(|at| list.indices[9 + at] as usize);
        assert_eq!(list.points[x].x, 1.0);
        assert_eq!(list.points[y].y, 2.0);
        assert_eq!(list.points[z].z, 3.0);
    }

    #[test]
    fn the_ends_of_a_capsule_are_the_ends_of_its_cylinder() {
        let (a, b) = ([0.1, 0.2, 0.3], [0.4, -0.2, 0.3]);
        let mut entity = SceneEntity::default();
        let solid = Solid::Capsule { a, b, radius: 0.05 };
        add(&mut entity, &solid, Color::default());
        assert_eq!(entity.spheres.len(), 2);
        let [cylinder] = &entity.cylinders[..] else {
            panic!("{entity:?}");
        };
        let size = cylinder.size.unwrap();
        assert!((size.z - 0.5).abs() < 1e-12 && (size.x - 0.1).abs() < 1e-12);
        let at = cylinder.pose.unwrap();
        let turn = at.orientation.unwrap();
        let turn = UnitQuaternion::new_unchecked(Q::new(turn.w, turn.x, turn.y, turn.z));
        let middle = at.position.unwrap();
        let end = V::new(middle.x, middle.y, middle.z) + turn * V::new(0.0, 0.0, size.z / 2.0);
        assert!((end - V::from(b)).norm() < 1e-12, "{end}");
        let ball = Solid::Capsule {
            a,
            b: a,
            radius: 0.05,
        };
        let mut entity = SceneEntity::default();
        add(&mut entity, &ball, Color::default());
        assert_eq!((entity.spheres.len(), entity.cylinders.len()), (1, 0));
    }
}
