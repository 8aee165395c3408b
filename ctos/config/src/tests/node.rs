//! Types read from nodes, and the places of what does not fit.

use super::*;

#[derive(Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
struct Arm {
    speed: f64,
    #[serde(default)]
    joints: Vec<Joint>,
    shape: Option<Shape>,
    kind: Option<Kind>,
}

#[derive(Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
struct Joint {
    limit: (f64, f64),
    gain: u8,
}

#[derive(Debug, Deserialize, PartialEq)]
#[serde(rename_all = "snake_case")]
enum Shape {
    Point,
    Ball(f64),
    Box { x: f64 },
}

#[derive(Debug, Deserialize, PartialEq)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
enum Kind {
    Pid { p: f64, joint: Option<Joint> },
}

fn arm(text: &str) -> Result<Arm, String> {
    let source = Source::new("arm.toml", text);
    let mut findings = Findings::new();
    let node = Node::from_toml(&source, &mut findings);
    assert!(findings.is_empty(), "{findings}");
    node.parse().map_err(|finding| finding.to_string())
}

#[test]
fn a_node_is_read_into_types_of_every_kind() {
    let read = arm(
        "speed = 1\njoints = [{ limit = [-1, 1.5], gain = 3 }]\nshape = { box = { x = 2 } }\nkind = { type = \"pid\", p = 0.5 }\n",
    );
    assert_eq!(
        read,
        Ok(Arm {
            speed: 1.0,
            joints: vec![Joint {
                limit: (-1.0, 1.5),
                gain: 3
            }],
            shape: Some(Shape::Box { x: 2.0 }),
            kind: Some(Kind::Pid {
                p: 0.5,
                joint: None
            }),
        })
    );
    assert_eq!(
        arm("speed = 1\nshape = \"point\"").unwrap().shape,
        Some(Shape::Point)
    );
    assert_eq!(
        arm("speed = 1\nshape.ball = 3").unwrap().shape,
        Some(Shape::Ball(3.0))
    );
}

#[test]
fn what_does_not_fit_a_type_is_an_error_at_its_exact_place() {
    let cases = [
        (
            "speed = 1\nspede = 2",
            "arm.toml:2:1: error: unknown key `spede` (did you mean `speed`?)",
        ),
        (
            "joints = []",
            "arm.toml:1:1: error: the key `speed` is missing (add `speed = ...`)",
        ),
        (
            "speed = \"fast\"",
            "arm.toml:1:9: error: `speed`: expected a number, found the string \"fast\"",
        ),
        (
            "speed = 1\n[[joints]]\nlimit = [0, 1]\ngain = 256",
            "arm.toml:4:8: error: `joints.0.gain`: the integer 256 does not fit, expected a whole number from 0 to 255",
        ),
        (
            "speed = 1\n[[joints]]\nlimit = [0, true]\ngain = 1",
            "arm.toml:3:13: error: `joints.0.limit.1`: expected a number, found the boolean true",
        ),
        (
            "speed = 1\n[[joints]]\nlimit = [0, 1, 2]\ngain = 1",
            "arm.toml:3:9: error: `joints.0.limit`: expected 2 elements, found 3",
        ),
        (
            "speed = 1\n[[joints]]\nlimit = [0]\ngain = 1",
            "arm.toml:3:9: error: `joints.0.limit`: expected a tuple of size 2, found 1",
        ),
        (
            "speed = 1\n[[joints]]\nlimit = [0, 1]\ngian = 1",
            "arm.toml:4:1: error: unknown key `gian` in `joints.0` (did you mean `gain`?)",
        ),
        (
            "speed = 1\nshape = \"pont\"",
            "arm.toml:2:9: error: unknown choice `pont` for `shape` (did you mean `point`?)",
        ),
        (
            "speed = 1\nshape.bxo.x = 1",
            "arm.toml:2:7: error: unknown choice `bxo` for `shape` (did you mean `box`?)",
        ),
        (
            "speed = 1\nshape = { point = 1 }",
            "arm.toml:2:19: error: `shape`: this choice takes no value: write it as a string",
        ),
        (
            "speed = 1\nshape = 7",
            "arm.toml:2:9: error: `shape`: expected one of point, ball, box, found an integer",
        ),
        (
            "speed = 1\n[kind]\ntype = \"pid\"\np = 1\njoint = { limit = [0, 1], gain = 1, giant = 3 }",
            "arm.toml:5:37: error: unknown key `giant` in `kind` (did you mean `gain`?)",
        ),
        (
            "speed = 1\nkind = { type = \"pid\", p = 1, dd = 3 }",
            "arm.toml:2:31: error: unknown key `dd` in `kind` (known here: joint, p)",
        ),
    ];
    for (text, expected) in cases {
        assert_eq!(arm(text), Err(expected.to_owned()), "for {text}");
    }
}

#[test]
fn a_path_finds_keys_elements_and_quoted_keys() {
    let source = Source::new("t", "a.b = [1, { c = 2 }]\n\"x.y\" = 3\n");
    let node = Node::from_toml(&source, &mut Findings::new());
    assert_eq!(node.get("a.b.1.c").and_then(Node::as_integer), Some(2));
    assert_eq!(node.locate("a.b.1.c").unwrap().to_string(), "t:1:13");
    assert_eq!(node.locate("a.b.0").unwrap().to_string(), "t:1:8");
    assert_eq!(node.get("\"x.y\"").and_then(Node::as_integer), Some(3));
    assert!(node.get("a.b.2").is_none() && node.get("a.b.c").is_none() && node.get("").is_none());
}
