//! An arm that others made, with meshes in every form that is read; and meshes that are wrong.

use std::fmt::Write as _;
use std::fs;

use ctos_config::diagnostic::Finding;
use proptest::prelude::*;

use super::*;
use crate::Solid;
use crate::urdf::{FromUrdf, read};

/// A folder of this test alone, gone after it.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("mcs-mesh-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // Whether it goes does not matter to any test.
        let _ = fs::remove_dir_all(&self.0);
    }
}

type Facet = [[f64; 3]; 3];

/// The facets of a twelve-sided prism along z, and one inside of it.
fn prism(radius: f64, length: f64) -> Vec<Facet> {
    let corner = |side: u32, z: f64| {
        let (sin, cos) = (f64::from(side % 12) * std::f64::consts::TAU / 12.0).sin_cos();
        [radius * cos, radius * sin, z]
    };
    let sides = (0..12).flat_map(|side| {
        let [a, b] = [corner(side, 0.0), corner(side + 1, 0.0)];
        let [c, d] = [corner(side, length), corner(side + 1, length)];
        [
            [a, b, c],
            [c, b, d],
            [[0.0; 3], b, a],
            [[0.0, 0.0, length], c, d],
        ]
    });
    sides.collect()
}

fn binary(facets: &[Facet]) -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(u32::try_from(facets.len()).unwrap().to_le_bytes());
    for facet in facets {
        bytes.extend([0; 12]);
        let numbers = facet.as_flattened().iter();
        #[allow(clippy::cast_possible_truncation, reason = "what the format holds")]
        bytes.extend(numbers.flat_map(|number| (*number as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn text(facets: &[Facet]) -> String {
    let mut text = "solid prism\n".to_owned();
    for facet in facets {
        text += "  facet normal 0 0 0\n    outer loop\n";
        for [x, y, z] in facet {
            let _ = writeln!(text, "      vertex {x:e} {y:e} {z:e}");
        }
        text += "    endloop\n  endfacet\n";
    }
    text + "endsolid prism\n\n"
}

/// In millimetres, with texture and normal, and indices that count backwards.
fn wavefront(facets: &[Facet]) -> String {
    let mut text = "# a prism\nmtllib none.mtl\no prism\nvn 0 0 1\nvt 0 0\n".to_owned();
    for facet in facets {
        for [x, y, z] in facet {
            let _ = writeln!(text, "v {} {} {} 1.0", x * 1e3, y * 1e3, z * 1e3);
        }
        text += "f -3/1/1 -2//1 -1\n";
    }
    text
}

/// The UR5 as `ur_description` has it: where its joints stand and how heavy its links are. The meshes are prisms.
fn ur5() -> String {
    let links = [
        ("base_link", 4.0, ""),
        ("shoulder_link", 3.7, ""),
        (
            "upper_arm_link",
            8.393,
            "<mesh filename=\"package://ur_description/meshes/ur5/collision/upperarm.stl\"/>",
        ),
        (
            "forearm_link",
            2.275,
            "<mesh filename=\"package://ur_description/meshes/ur5/collision/forearm.STL\"/>",
        ),
        (
            "wrist_1_link",
            1.219,
            "<mesh filename=\"../meshes/ur5/collision/wrist1.obj\" scale=\"0.001 0.001 0.001\"/>",
        ),
        (
            "wrist_2_link",
            1.219,
            "<mesh filename=\"package://ur_description/meshes/ur5/collision/wrist2.dae\"/>",
        ),
        (
            "wrist_3_link",
            0.1879,
            "<mesh filename=\"package://elsewhere/wrist3.stl\"/>",
        ),
    ];
    let joints = [
        ("shoulder_pan", "0 0 0.089159", "0 0 0", "0 0 1"),
        (
            "shoulder_lift",
            "0 0.13585 0",
            "0 1.570796326794897 0",
            "0 1 0",
        ),
        ("elbow", "0 -0.1197 0.425", "0 0 0", "0 1 0"),
        ("wrist_1", "0 0 0.39225", "0 1.570796326794897 0", "0 1 0"),
        ("wrist_2", "0 0.093 0", "0 0 0", "0 0 1"),
        ("wrist_3", "0 0 0.09465", "0 0 0", "0 1 0"),
    ];
    let mut text = "<robot name=\"ur5\">\n".to_owned();
    for (name, mass, mesh) in links {
        let form = match mesh {
            "" => String::new(),
            mesh => format!("<collision><geometry>{mesh}</geometry></collision>"),
        };
        let _ = writeln!(
            text,
            "<link name=\"{name}\"><inertial><mass value=\"{mass}\"/><inertia ixx=\"0.01\" ixy=\"0\" ixz=\"0\" \
             iyy=\"0.01\" iyz=\"0\" izz=\"0.01\"/></inertial>{form}</link>"
        );
    }
    for (index, (name, xyz, rpy, axis)) in joints.iter().enumerate() {
        let _ = writeln!(
            text,
            "<joint name=\"{name}_joint\" type=\"revolute\"><parent link=\"{}\"/><child link=\"{}\"/><origin \
             xyz=\"{xyz}\" rpy=\"{rpy}\"/><axis xyz=\"{axis}\"/><limit lower=\"-6.28318530718\" upper=\"6.28318530718\" \
             effort=\"150\" velocity=\"3.15\"/></joint>",
            links[index].0,
            links[index + 1].0
        );
    }
    text += "<link name=\"ee_link\"/><joint name=\"ee_fixed_joint\" type=\"fixed\"><parent link=\"wrist_3_link\"/>\
             <child link=\"ee_link\"/><origin xyz=\"0 0.0823 0\" rpy=\"0 0 1.570796326794897\"/></joint>\n";
    text + "</robot>\n"
}

#[test]
fn an_arm_of_another_project_is_read_with_the_hulls_of_its_meshes_where_they_stand() {
    let folder = Folder::new("ur5");
    let urdf = folder.write("ur_description/urdf/ur5.urdf", ur5());
    let mesh = |name: &str, bytes: &[u8]| {
        folder.write(
            &format!("ur_description/meshes/ur5/collision/{name}"),
            bytes,
        );
    };
    mesh("upperarm.stl", &binary(&prism(0.06, 0.425)));
    mesh("forearm.STL", text(&prism(0.05, 0.39225)).as_bytes());
    mesh("wrist1.obj", wavefront(&prism(0.04, 0.093)).as_bytes());
    mesh("wrist2.dae", b"<COLLADA/>");
    let FromUrdf { model, warnings } = read(&urdf, None, None).unwrap();
    // The pose with all joints at 0, as published for the UR5.
    let mut data = model.data();
    let tip = model.placement(&mut data, &[0.0; 6], model.tip()).origin;
    let known = Vector3::new(0.81725, 0.19145, -0.005491);
    assert!((tip - known).norm() < 1e-9, "{tip}");
    let told: Vec<String> = warnings.iter().map(ToString::to_string).collect();
    let unread = "the meshes of wrist_2_link, wrist_3_link for collisions are not read: nothing watches them (`package://ur_description/meshes/ur5/collision/wrist2.dae` is neither STL nor OBJ)";
    assert!(told.iter().any(|told| told.contains(unread)), "{told:?}");
    let [upper_arm, forearm, wrist] = model.shapes() else {
        panic!("{:?}", model.shapes());
    };
    // Both links lie along x of the base, the wrist along -z; no hull has more corners than its prism has points.
    for (shape, [low, high]) in [
        (
            upper_arm,
            [[0.0, 0.07585, 0.029159], [0.425, 0.19585, 0.149159]],
        ),
        (
            forearm,
            [[0.425, -0.03385, 0.039159], [0.81725, 0.06615, 0.139159]],
        ),
        (
            wrist,
            [[0.77725, -0.02385, -0.003841], [0.85725, 0.05615, 0.089159]],
        ),
    ] {
        let solid = shape.solid.seen_from(&data.carrier(shape.carrier));
        let Solid::Hull { hull, .. } = &solid else {
            panic!("{shape:?}");
        };
        assert!(hull.corners().len() <= 26, "{}", hull.corners().len());
        assert!(hull.rounding() < 1e-6, "{}", hull.rounding());
        for axis in 0..3 {
            let direction = Vector3::from_fn(|row, _| f64::from(row == axis));
            let found = [
                solid.farthest(&-direction)[axis],
                solid.farthest(&direction)[axis],
            ];
            let off = (found[0] - low[axis])
                .abs()
                .max((found[1] - high[axis]).abs());
            assert!(
                off < 1e-6,
                "axis {axis}: {found:?}, not {} {}",
                low[axis],
                high[axis]
            );
        }
    }
}

fn with_mesh(folder: &Folder, name: &str) -> Result<FromUrdf, Finding> {
    let text = format!(
        "<robot name=\"r\">\n<link name=\"a\"/>\n<link name=\"b\"><collision><geometry><mesh filename=\"{name}\"/></geometry></collision></link>\n\
         <joint name=\"j\" type=\"fixed\"><parent link=\"a\"/><child link=\"b\"/></joint>\n</robot>"
    );
    read(&folder.write("arm.urdf", text), None, None)
}

#[test]
fn a_mesh_that_is_wrong_is_a_finding_with_its_place_and_what_is_wrong_where_in_it() {
    let folder = Folder::new("wrong");
    let facets = prism(0.1, 0.2);
    let (whole, readable) = (binary(&facets), text(&facets));
    let edited = |from: &str, to: &str| readable.replacen(from, to, 1).into_bytes();
    let mut infinite = whole.clone();
    infinite[HEADER + FACET + 12..HEADER + FACET + 16]
        .copy_from_slice(&f32::INFINITY.to_le_bytes());
    let mut many = whole.clone();
    many[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let cut = |bytes: &[u8], length: usize| bytes[..length].to_vec();
    let cases: [(&str, Vec<u8>, &str); 15] = [
        (
            "a.stl",
            cut(&whole, 1000),
            "says that it has 48 facets, which are 2484 bytes, and has 1000",
        ),
        ("a.stl", many, "says that it has 4294967295 facets"),
        ("a.stl", infinite, "facet 2: a corner is not finite"),
        ("a.stl", cut(&whole, 50), "is no STL"),
        ("a.stl", Vec::new(), "is no STL"),
        ("a.stl", binary(&[]), "has no facets"),
        (
            "a.stl",
            edited("vertex 1e-1", "vertex 1e-1,0"),
            "line 4: not a number: `1e-1,0`",
        ),
        (
            "a.stl",
            edited("vertex 1e-1", "vertex nan"),
            "line 4: not a number: `nan`",
        ),
        (
            "a.stl",
            edited("    endloop\n", "vertex 0 0 0\nendloop\n"),
            "line 8: a facet has three corners",
        ),
        (
            "a.stl",
            edited("outer loop", "inner loop"),
            "line 3: `inner` is no word of an STL",
        ),
        (
            "a.stl",
            cut(readable.as_bytes(), readable.len() - 16),
            "ends before its `endsolid`",
        ),
        ("a.obj", b"v 0 0\n".to_vec(), "line 1: not a number: ``"),
        (
            "a.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n".to_vec(),
            "line 4: there is no corner `4`",
        ),
        (
            "a.obj",
            b"v 0 0 0\nf 1 0 -2\n".to_vec(),
            "line 2: there is no corner `0`",
        ),
        (
            "a.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_vec(),
            "has no facets",
        ),
    ];
    for (name, bytes, what) in cases {
        folder.write(name, bytes);
        let found = with_mesh(&folder, name).expect_err(what);
        let expected = format!("no mesh: `{name}` of link `b` {what}");
        assert!(
            found.message.starts_with(&expected),
            "{}: {what}",
            found.message
        );
        let place = found.place.unwrap().to_string();
        assert!(place.ends_with("arm.urdf:3:16"), "{place}");
    }
}

#[test]
fn a_mesh_that_is_too_large_is_refused_before_it_is_read_and_one_that_is_no_file_is_told_of() {
    let folder = Folder::new("large");
    let path = folder.write("large.stl", b"");
    let file = fs::File::options().write(true).open(path).unwrap();
    file.set_len((16 << 20) + 1).unwrap();
    let found = with_mesh(&folder, "large.stl").unwrap_err();
    assert!(
        found
            .message
            .contains("has 16777217 bytes, and 16777216 are left"),
        "{found}"
    );
    for missing in ["/dev/zero.stl", "gone.stl", "package://r", "", "."] {
        let read = with_mesh(&folder, missing).unwrap();
        assert!(read.model.shapes().is_empty());
        assert!(read.warnings[0].message.contains("nothing watches them"));
    }
}

proptest! {
    #[test]
    fn any_bytes_are_points_or_a_reason(bytes in prop::collection::vec(any::<u8>(), 0..300), text in "(v|f|solid|vertex|endloop|[-0-9. \n/]){0,60}") {
        for bytes in [bytes.as_slice(), text.as_bytes()] {
            for points in [stl(bytes), obj(bytes)] {
                prop_assert!(points.is_err() || points.unwrap().iter().flatten().all(|number| number.is_finite()));
            }
        }
    }
}
