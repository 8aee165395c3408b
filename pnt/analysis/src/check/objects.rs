//! Whether an action's data objects fit what it calls: as many as there are fields, or one that is all of them.
//! It knows how many fields a type has, and nothing of what is in an object.

use ctos::{diagnostic::Finding, message::DataType};

/// The data objects of an action: those that go along, and those that its result is stored as.
pub type Objects<'a> = (&'a [String], &'a [String]);

const CODE: &str = "pnt::net::data_objects";

/// What is wrong with the data objects of an action that calls `what`, which takes and gives values of
/// these types.
pub fn check(
    what: &str,
    (inputs, outputs): Objects<'_>,
    (arguments, results): (DataType, DataType),
) -> Vec<Finding> {
    let mut found = Vec::new();
    let (given, wanted) = (inputs.len(), arguments.fields());
    if given != wanted && !(given == 1 && wanted > 1) {
        let text = format!(
            "{what} takes {}, and {} with it",
            counted(wanted, "argument"),
            there(given, "goes", "go")
        );
        found.push(Finding::error(CODE, text).help(match wanted {
            0 => "name no data object before `->`",
            1 => "name one data object before `->`",
            _ => "name one data object before `->` for each argument, in order, or one that holds all of them",
        }));
    }
    let (taken, given) = (outputs.len(), results.fields());
    if taken > 1 && taken != given {
        let text = format!(
            "{what} gives {}, and {} there to take them",
            counted(given, "result"),
            there(taken, "is", "are")
        );
        found.push(Finding::error(CODE, text).help(match given {
            0 | 1 => "name one data object behind `->`, or none",
            _ => "name one data object behind `->` for each result, in order, or one for all of them, or none",
        }));
    }
    found
}

/// What is wrong with the data objects of an action that calls `what`, which takes none, for a reason.
pub fn none(what: &str, why: &str, (inputs, outputs): Objects<'_>) -> Vec<Finding> {
    if inputs.is_empty() && outputs.is_empty() {
        return Vec::new();
    }
    let text = format!("{what} takes no data objects from a net and gives none: {why}");
    vec![Finding::error(CODE, text).help("leave out what stands in parentheses")]
}

fn counted(count: usize, what: &str) -> String {
    match count {
        0 => format!("no {what}s"),
        1 => format!("1 {what}"),
        _ => format!("{count} {what}s"),
    }
}

fn there(count: usize, one: &str, more: &str) -> String {
    match count {
        0 => format!("no data objects {more}"),
        1 => format!("1 data object {one}"),
        _ => format!("{count} data objects {more}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(inputs: usize, outputs: usize, types: (DataType, DataType)) -> Vec<String> {
        let names = |count| vec![String::from("o"); count];
        let (inputs, outputs) = (names(inputs), names(outputs));
        let found = check("it", (&inputs, &outputs), types);
        found.into_iter().map(|finding| finding.message).collect()
    }

    #[test]
    fn as_many_objects_as_fields_or_one_for_all_of_them() {
        let types = (DataType::of::<(u8, u8, u8)>(), DataType::of::<(u8, u8)>());
        for (inputs, outputs) in [(3, 0), (3, 1), (3, 2), (1, 2)] {
            assert_eq!(found(inputs, outputs, types), Vec::<String>::new());
        }
        assert_eq!(
            found(2, 3, types),
            [
                "it takes 3 arguments, and 2 data objects go with it",
                "it gives 2 results, and 3 data objects are there to take them"
            ]
        );
        assert_eq!(
            found(0, 2, types),
            ["it takes 3 arguments, and no data objects go with it"]
        );
        let plain = (DataType::of::<()>(), DataType::of::<u64>());
        assert_eq!(found(0, 1, plain), Vec::<String>::new());
        assert_eq!(
            found(1, 2, plain),
            [
                "it takes no arguments, and 1 data object goes with it",
                "it gives 1 result, and 2 data objects are there to take them"
            ]
        );
    }
}
