use std::collections::BTreeMap;

use ctos::message::{CommandInfo, Shape};
use proptest::prelude::*;
use serde::Deserialize;

use super::*;
use crate::types::Declared;

#[derive(Debug, Clone, Serialize, Deserialize)]
enum Way {
    Stop,
    Go(f64),
    Both(i32, String),
    Turn { by: f32, left: bool },
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Unit;

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Wrapped(u16);

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Whole {
    ways: Vec<Way>,
    #[serde(rename = "called")]
    name: Option<String>,
    by_number: BTreeMap<i64, char>,
    by_name: BTreeMap<String, (Unit, Wrapped)>,
    matrix: [[f64; 3]; 2],
    large: u128,
    bytes: Vec<u8>,
    next: Option<Box<Whole>>,
}

fn way() -> impl Strategy<Value = Way> {
    prop_oneof![
        Just(Way::Stop),
        any::<f64>().prop_map(Way::Go),
        (any::<i32>(), ".{0,5}").prop_map(|(number, text)| Way::Both(number, text)),
        (any::<f32>(), any::<bool>()).prop_map(|(by, left)| Way::Turn { by, left }),
    ]
}

fn leaf() -> impl Strategy<Value = Whole> {
    let leaf = (
        proptest::collection::vec(way(), 0..5),
        any::<Option<String>>(),
        proptest::collection::btree_map(any::<i64>(), any::<char>(), 0..3),
        proptest::collection::btree_map(".{0,3}", any::<u16>(), 0..3),
        any::<[[f64; 3]; 2]>(),
        any::<u128>(),
        proptest::collection::vec(any::<u8>(), 0..9),
    );
    leaf.prop_map(
        |(ways, name, by_number, by_name, matrix, large, bytes)| Whole {
            ways,
            name,
            by_number,
            by_name: by_name
                .into_iter()
                .map(|(name, number)| (name, (Unit, Wrapped(number))))
                .collect(),
            matrix,
            large,
            bytes,
            next: None,
        },
    )
}

fn whole() -> impl Strategy<Value = Whole> {
    (leaf(), proptest::option::of(leaf())).prop_map(|(mut whole, next)| {
        whole.next = next.map(Box::new);
        whole
    })
}

proptest! {
    #[test]
    fn json_becomes_the_bytes_that_it_was_made_of(whole in whole()) {
        // JSON has no whole numbers beyond 64 bits.
        let whole = Whole { large: u128::from(whole.large as u64), next: None, ..whole };
        let shape = Shape::of::<Whole>().unwrap();
        let bytes = postcard::to_stdvec(&whole).unwrap();
        let json = told(&shape, &bytes, 1 << 20).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&json).unwrap();
        let again = encoded(&shape, &value).unwrap();
        // JSON has the keys of a map in another order, so what is read is compared; by its bytes, as zero has a sign.
        let read: Whole = postcard::from_bytes(&again).unwrap();
        prop_assert_eq!(bytes, postcard::to_stdvec(&read).unwrap());
    }
}

#[test]
fn a_declared_type_is_that_of_the_same_fields_and_tells_what_does_not_fit() {
    let text =
        r#"{"u": "px", "name": "text?", "way": "left | right", "at": ["m", "m"], "all": ["u8"]}"#;
    let Declared(shape) = serde_json::from_str(text).unwrap();
    assert_eq!(
        Shown(&shape).to_string(),
        "{u: px, name: text?, way: left | right, at: [m, m], all: [u8]}"
    );
    let value = serde_json::json!({"u": 1.5, "way": "right", "at": [1, 2], "all": "/wA="});
    let bytes = encoded(&shape, &value).unwrap();
    let same = (1.5, None::<String>, 1_u32, [1.0, 2.0], vec![255_u8, 0]);
    assert_eq!(bytes, postcard::to_stdvec(&same).unwrap());
    let declared = CommandInfo::declared(1, "look", "", shape.clone(), shape.clone()).request;
    assert_eq!(
        (declared.fields(), declared.split(&bytes).unwrap().concat()),
        (5, bytes.clone())
    );
    declared.split(&bytes[..bytes.len() - 1]).unwrap_err();
    let json = told(&shape, &bytes, 1000).unwrap();
    assert_eq!(
        String::from_utf8(json).unwrap(),
        r#"{"u":1.5,"name":null,"way":"right","at":[1.0,2.0],"all":"/wA="}"#
    );
    for (wrong, why) in [
        (r#"{"u": "1"}"#, "`u`: \"1\" is no px"),
        (
            r#"{"u": 1, "way": "up"}"#,
            "`way`: \"up\" is none of left, right",
        ),
        (
            r#"{"u": 1, "way": "left", "at": [1]}"#,
            "`at`: it has 1 values, not 2",
        ),
        (
            r#"{"u": 1, "way": "left", "at": [1, true]}"#,
            "`at.1`: true is no m",
        ),
        (r#"{"v": 1}"#, "there is no field `v`"),
        ("[]", "[] is no {u"),
    ] {
        let value = serde_json::from_str(wrong).unwrap();
        let error = encoded(&shape, &value).unwrap_err();
        assert!(error.contains(why), "{error}");
    }
    let error = serde_json::from_str::<Declared>(r#"{"u": "pixel"}"#).unwrap_err();
    assert!(
        error.to_string().contains("there is no type `pixel`"),
        "{error}"
    );
}
