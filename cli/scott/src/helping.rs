//! What a person at the prompt is shown and need not write. That is help from the descriptions of the classes, what
//! there is, and numbers without `FMSG` and their count. Knows no terminal.

use std::{borrow::Cow, fmt::Write as _};

use ctos::diagnostic::Finding;
use serde_json::{Value, json};
use sorma::{
    ClassInfo, Form, Request,
    describe::{self, FormInfo, Layout, OptionInfo},
    words::{self, Word},
};

/// What `help` says before the statements.
pub(crate) const FIRST: &str = "\
Ask an object by its name, and a method:
  kin.puma560 EXEC fkine 0 0 0 0 0 0   has it do its job with these numbers
  kin.puma560 CTRL -limits off         changes an option; -dump tells them all
  kin.puma560 DBX -statistics          tells about the object itself
What there is:
  list                                 all objects and classes
  list ARM                             those with ARM in their names
  kin.puma560                          what an object can do;
                                       also: help kin.puma560, kin.puma560 ?
Answers are rounded to six digits; $FMSG has all of them, and so has scott -c.
";

/// The class that a name means.
pub(crate) fn class_of<'a>(name: &str, classes: &'a [ClassInfo]) -> Option<&'a ClassInfo> {
    let class = name.split(['.', '@']).next().unwrap_or(name);
    let lower = class.to_ascii_lowercase();
    let mut classes = classes.iter();
    classes.find(|info| info.name == class || info.name == lower)
}

/// What an object can do, or that there is no such object.
pub(crate) fn about(name: &str, classes: &[ClassInfo]) -> Result<String, String> {
    let Some(class) = class_of(name, classes) else {
        let known = classes.iter().map(|class| class.name.as_str());
        let help = match name.len() {
            ..100 => Finding::error("scott", "").suggest(name, known).help,
            _ => None,
        };
        let help = help.map(|help| format!("; {help}")).unwrap_or_default();
        let name: String = name.chars().take(60).collect();
        return Err(format!(
            "there is no statement and no object `{name}`; `list` tells what there is, `help` how it is asked{help}"
        ));
    };
    // Writing to a `String` cannot fail.
    let mut text = format!("{name}: {} (version {})", class.about, class.version);
    for form in &class.forms {
        let numbers = match form.floats {
            0 => String::new(),
            1 => " NUMBER".to_owned(),
            Form::ANY => " NUMBERS".to_owned(),
            count => format!(" {count} NUMBERS"),
        };
        let words = match form.text.as_str() {
            "" => String::new(),
            words => format!(" {words}"),
        };
        let _ = write!(text, "\n{name} EXEC{words}{numbers}");
        let _ = write!(text, "\n      {}", form.help);
        if form.floats > 0 {
            let _ = write!(text, "\n      takes {}", form.takes);
        }
        let _ = write!(text, "\n      gives {}", form.gives);
    }
    let _ = write!(text, "\n{name} CTRL");
    let dump = (
        "-dump".to_owned(),
        "tells all options as they are".to_owned(),
    );
    let own = class.options.iter().map(option);
    described(&mut text, own.chain([dump]));
    let _ = write!(text, "\n{name} DBX");
    described(&mut text, describe::dbx_options().iter().map(option));
    Ok(text)
}

fn option(option: &OptionInfo) -> (String, String) {
    let form = option.form();
    let default = option.default.as_ref();
    let default = default.map(|value| format!(" (default {value})"));
    let called = format!("-{} {form}", option.name);
    let meaning = format!("{}{}", option.help, default.unwrap_or_default());
    (called.trim_end().to_owned(), meaning)
}

fn described(text: &mut String, options: impl Iterator<Item = (String, String)>) {
    for (called, meaning) in options {
        // Writing to a `String` cannot fail.
        let _ = write!(text, "\n  {called:<28} {meaning}");
    }
}

/// A class, with the names of its objects and flavors.
pub(crate) struct Listed<'a> {
    class: &'a ClassInfo,
    names: Vec<&'a str>,
}

/// The classes, and below each the names of its objects and flavors, of those with `part` in a name.
pub(crate) fn listed<'a>(
    part: &str,
    names: &'a [String],
    classes: &'a [ClassInfo],
) -> Vec<Listed<'a>> {
    let all = classes.iter().map(|class| {
        let own = names.iter().map(String::as_str);
        let own = own.filter(|name| {
            name.split('.').next() == Some(class.name.as_str()) && **name != class.name
        });
        let names = own.filter(|name| name.contains(part)).collect();
        Listed { class, names }
    });
    all.filter(|listed| listed.class.name.contains(part) || !listed.names.is_empty())
        .collect()
}

impl Listed<'_> {
    pub(crate) fn text(&self) -> String {
        let about = self.class.about.split(['.', ';', ':']).next();
        let mut text = format!("{:<10} {}", self.class.name, about.unwrap_or_default());
        for names in self.names.chunks(6) {
            // Writing to a `String` cannot fail.
            let _ = write!(text, "\n{:<10}   {}", "", names.join("  "));
        }
        text
    }

    pub(crate) fn json(&self) -> Value {
        json!({ "class": self.class.name, "about": self.class.about, "names": self.names })
    }
}

/// A request as a person types it, with `FMSG` and their count before its numbers where its class takes some there.
/// Whatever cannot be told stays as it is.
pub(crate) fn spoken<'a>(line: &'a str, classes: &[ClassInfo]) -> Cow<'a, str> {
    written(line, classes).map_or(Cow::Borrowed(line), Cow::Owned)
}

fn written(line: &str, classes: &[ClassInfo]) -> Option<String> {
    let words = words::split(line).ok()?;
    let (name, rest) = match words.as_slice() {
        [name, method, rest @ ..] if method.text == "EXEC" && !method.quoted => (name, rest),
        _ => return None,
    };
    let announced = |word: &Word| !word.quoted && ["FMSG", "IMSG", "TDBX"].contains(&&*word.text);
    if rest.iter().any(announced) {
        return None;
    }
    let class = class_of(&name.text, classes)?;
    let start = words.get(1)?.span.end;
    let from = match rest.first() {
        Some(word) if word.text == "TMSG" && !word.quoted => 1,
        _ => 0,
    };
    let numbers = rest.iter().rev().take_while(|word| is_number(word)).count();
    let numbers = numbers.min(rest.len() - from);
    // The text of the request when so many words at its end are numbers.
    let text = |count: usize| -> Option<&str> {
        let own = rest.get(from..rest.len() - count)?;
        match (own.first(), own.last()) {
            (Some(first), Some(last)) => line.get(first.span.start..last.span.end),
            _ => Some(""),
        }
    };
    let with = |skipped: usize, count: usize| -> Option<String> {
        let own = rest.get(rest.len() - count..)?;
        let end = match rest.get(..rest.len() - count - skipped)? {
            [.., last] => last.span.end,
            [] => start,
        };
        let first = own.first()?.span.start;
        Some(format!(
            "{} FMSG {count} {}",
            line.get(..end)?,
            line.get(first..)?
        ))
    };
    let takes = |text: &str, count: usize| {
        let forms = class.forms.iter();
        let fits = |form: &&FormInfo| count > 0 && form.takes_so_many(count) && form.is_of(text);
        forms.clone().any(|form| fits(&form))
    };
    if let Some(count) = (1..=numbers)
        .rev()
        .find(|count| text(*count).is_some_and(|text| takes(text, *count)))
    {
        return with(0, count);
    }
    // $FMSG stands for the last answer's numbers after their count.
    for count in (1..numbers).rev() {
        let announced = rest.get(rest.len() - count - 1)?;
        if announced.text.parse() == Ok(count)
            && text(count + 1).is_some_and(|text| takes(text, count))
        {
            return with(1, count);
        }
    }
    // Too many or too few: the object says how many it takes.
    let text = text(numbers)?;
    let forms = class
        .forms
        .iter()
        .filter(|form| form.floats > 0 && !form.placeholder);
    let is_meant = numbers > 0 && forms.clone().any(|form| form.is_of(text));
    is_meant.then(|| with(0, numbers)).flatten()
}

fn is_number(word: &Word) -> bool {
    let begins = |first: char| first.is_ascii_digit() || "+-.".contains(first);
    !word.quoted && word.text.starts_with(begins) && word.text.parse::<f64>().is_ok()
}

/// What the numbers of the answer to a request are; nothing when that is not known.
pub(crate) fn layout(line: &str, classes: &[ClassInfo]) -> Layout {
    let Ok(request) = line.parse::<Request>() else {
        return Layout::default();
    };
    if request.method != sorma::Method::Exec {
        return Layout::default();
    }
    let class = class_of(&request.name.local(), classes);
    let form = class.and_then(|class| class.form(&request.body.text, request.body.floats.len()));
    form.map(FormInfo::layout).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::services::CLASSES;

    fn said(line: &str) -> String {
        spoken(line, &CLASSES).into_owned()
    }

    #[test]
    fn numbers_need_no_keyword_and_no_count() {
        assert_eq!(
            said("kin.puma560 EXEC fkine 0 0 0 0 0 0"),
            "kin.puma560 EXEC fkine FMSG 6 0 0 0 0 0 0"
        );
        assert_eq!(
            said("KIN EXEC TMSG fkine 0 -1 .5 0 0 1e-3"),
            "KIN EXEC TMSG fkine FMSG 6 0 -1 .5 0 0 1e-3"
        );
        assert_eq!(
            said("foo@d2 EXEC 1 2 3 4 5 6"),
            "foo@d2 EXEC FMSG 6 1 2 3 4 5 6"
        );
        // Variables bring the count along.
        assert_eq!(
            said("kin EXEC fkine 6 0 0 0 0 0 0"),
            "kin EXEC fkine FMSG 6 0 0 0 0 0 0"
        );
        // The object says how many it takes.
        assert_eq!(said("kin EXEC fkine 0 0"), "kin EXEC fkine FMSG 2 0 0");
    }

    /// What a form is asked with, its numbers as they stand and announced.
    fn asked(class: &str, form: &FormInfo) -> (String, String) {
        let words = form
            .text
            .replace(|letter: char| letter.is_ascii_uppercase(), "x");
        let count = form.floats.min(9);
        let numbers: Vec<String> = (0..count).map(|number| format!("{number}.5")).collect();
        let start = format!("{class} EXEC {words}");
        let (start, numbers) = (start.trim_end(), numbers.join(" "));
        let announced = format!("{start} FMSG {count} {numbers}");
        (format!("{start} {numbers}"), announced)
    }

    #[test]
    fn numbers_need_no_keyword_in_any_request_of_any_class() {
        for class in CLASSES.iter() {
            for form in class.forms.iter().filter(|form| form.floats > 0) {
                let (typed, announced) = asked(&class.name, form);
                assert_eq!(said(&typed), announced);
            }
            let takes_floats = ["with FMSG", "EXEC FMSG", "any data"]
                .iter()
                .any(|words| class.about.contains(words));
            let declared = class.forms.iter().any(|form| form.floats > 0);
            assert!(declared || !takes_floats, "{}", class.name);
        }
        assert_eq!(said("event EXEC 1 2"), "event EXEC FMSG 2 1 2");
        assert_eq!(said("queue.a EXEC put 7"), "queue.a EXEC put FMSG 1 7");
        assert_eq!(
            said("blackboard EXEC swap pose 3 0.5 1"),
            "blackboard EXEC swap pose 3 FMSG 2 0.5 1"
        );
        assert_eq!(said("fork.sound EXEC 440"), "fork.sound EXEC FMSG 1 440");
    }

    #[test]
    fn what_is_no_number_of_a_form_stays_as_it_is() {
        for line in [
            "kin EXEC fkine FMSG 6 0 0 0 0 0 0",
            "spot EXEC camera 3",
            "spot EXEC 2024.png",
            "queue EXEC take 3",
            "queue EXEC put '1' '2'",
            "queue EXEC claim 4",
            "blackboard EXEC swap pose 3",
            "shmem_r EXEC history 3",
            "later EXEC collect 1",
            "kin EXEC fkine '0'",
            "kin CTRL -d1 0.5",
            "nobody EXEC 1 2",
            "kin EXEC",
            "kin",
            "",
            "kin EXEC 'open",
            "kin EXEC nan inf",
            "mvpos EXEC 7",
        ] {
            assert_eq!(said(line), line);
        }
    }

    #[test]
    fn every_form_of_every_class_has_a_layout_that_can_be_read() {
        for class in CLASSES.iter() {
            for form in &class.forms {
                let layout = form.results.parse::<Layout>();
                assert!(layout.is_ok(), "{} {}: {layout:?}", class.name, form.text);
            }
        }
    }

    #[test]
    fn help_about_an_object_has_its_requests_options_and_units() {
        let text = about("kin.puma560", &CLASSES).unwrap();
        for part in [
            "kin.puma560 EXEC fkine 6 NUMBERS",
            "takes joint positions q1 to q6, rad",
            "-limits on|off",
            "-statistics",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let unknown = about("kim", &CLASSES).unwrap_err();
        assert!(unknown.contains("did you mean `kin`?"), "{unknown}");
        assert!(about(&"x".repeat(1000), &CLASSES).unwrap_err().len() < 300);
    }

    #[test]
    fn every_help_fits_a_terminal_of_80_columns_with_its_words_whole() {
        let first = format!("{FIRST}{}", crate::STATEMENTS);
        // The first help is written for it.
        assert!(first.lines().all(|line| line.len() <= 80), "{first}");
        let about = CLASSES
            .iter()
            .map(|class| about(&class.name, &CLASSES).unwrap());
        let known: Vec<String> = CLASSES.iter().map(|class| class.name.clone()).collect();
        let listed = listed("", &known, &CLASSES);
        let listed = listed.iter().map(Listed::text);
        let unknown = super::about("nobody", &CLASSES).unwrap_err();
        for text in about.chain(listed).chain([first, unknown]) {
            let shown = cli_common::table::wrapped(&text, 80);
            assert!(
                shown.lines().all(|line| line.chars().count() <= 80),
                "{shown}"
            );
            assert!(
                shown.split_whitespace().eq(text.split_whitespace()),
                "{shown}"
            );
        }
    }

    #[test]
    fn what_there_is_stands_below_its_class() {
        let names = ["kin.puma560", "kin", "foo.a", "foo.b", "d1"].map(str::to_owned);
        let all = listed("", &names, &CLASSES);
        assert_eq!(all.len(), CLASSES.len());
        let kin = listed("puma", &names, &CLASSES);
        assert_eq!(kin.len(), 1);
        assert!(kin[0].text().contains("kin.puma560"));
        assert_eq!(kin[0].json()["names"], json!(["kin.puma560"]));
        assert!(listed("none such", &names, &CLASSES).is_empty());
    }
}
