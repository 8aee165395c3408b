//! What every keyword of net text is for, in one table: for editors, and held against
//! `docs/net-text.md` by a test.

use super::keywords::{CLAUSES, DECLARATIONS};

/// A keyword, a line with it, and what the line says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Keyword {
    /// The word that begins the line.
    pub word: &'static str,
    /// A line.
    pub form: &'static str,
    /// What it says, in one sentence.
    pub meaning: &'static str,
}

const fn keyword(word: &'static str, form: &'static str, meaning: &'static str) -> Keyword {
    Keyword {
        word,
        form,
        meaning,
    }
}

/// All keywords, declarations first.
pub const KEYWORDS: [Keyword; 34] = [
    keyword(
        "net",
        "net NAME \"title\"",
        "The net's name, by which other nets address its places.",
    ),
    keyword(
        "place",
        "place P = 2 capacity 5 data OBJECT",
        "A place: its initial tokens, the most it may hold, the data object whose validity it says.",
    ),
    keyword(
        "data",
        "data D : int = 0",
        "A value that the net keeps: an `int`, `float`, `bool`, `text` or a float in a unit.",
    ),
    keyword(
        "command",
        "command C(a : int) -> A, B",
        "`C` may be put on the input tape, with these arguments; one of `A`, `B` answers it.",
    ),
    keyword(
        "coordinator",
        "coordinator N : r, s",
        "This net asks net `N` for `r` and `s`.",
    ),
    keyword(
        "serves",
        "serves N : r, s ; done D ; failed F",
        "This net serves requests of net `N`.",
    ),
    keyword(
        "safe",
        "safe P, Q*2",
        "While these tokens are there and no action goes on, the net may be replaced.",
    ),
    keyword(
        "transition",
        "transition T",
        "Opens a transition; the lines below belong to it.",
    ),
    keyword(
        "subnet",
        "subnet NAME(a, b)",
        "Opens a subnet with parameters, up to `end`.",
    ),
    keyword("use", "use NAME(x, y) as I", "An instance of a subnet."),
    keyword("end", "end", "Ends a subnet."),
    keyword(
        "include",
        "include \"FILE.net\"",
        "Takes the subnets of another file.",
    ),
    keyword("in", "in P, Q*2", "Takes these tokens when it starts."),
    keyword("read", "read P", "Needs these tokens and leaves them."),
    keyword(
        "inhibit",
        "inhibit P*2",
        "Only while the place holds fewer tokens than this.",
    ),
    keyword("reset", "reset P", "Empties the place when it starts."),
    keyword(
        "tape",
        "tape C",
        "Needs the symbol at the head of the input tape, and reads it.",
    ),
    keyword(
        "when",
        "when not F",
        "Only while the enabling function, or the expression, says yes (with `not`, no).",
    ),
    keyword(
        "do",
        "do F(IN -> OUT)",
        "Action: calls the local function, with data objects and for data objects.",
    ),
    keyword("ask", "ask N r", "Action: the request to the coordinator."),
    keyword(
        "send",
        "send TASK.COMMAND(IN -> OUT)",
        "Action: sends the command to the task, with data objects and for data objects.",
    ),
    keyword(
        "request",
        "request \"OBJECT EXEC go FMSG 1 $d\"",
        "Action: a line to a service object; `$d` stands for a value.",
    ),
    keyword("wait", "wait 2 s", "Action: waits that long."),
    keyword(
        "log",
        "log \"at $d\"",
        "Action: a line of the log; `$d` stands for a value.",
    ),
    keyword(
        "set",
        "set d = d + 1",
        "Gives data a value when the action is complete; `reply` is what a request was answered.",
    ),
    keyword(
        "idempotent",
        "idempotent",
        "The action may be asked again after a crash.",
    ),
    keyword(
        "out",
        "out P, Q*2, R@net",
        "Puts tokens when the action is complete; `R@net` is a place of another net.",
    ),
    keyword(
        "fail",
        "fail P",
        "Puts these instead when the action has failed.",
    ),
    keyword(
        "write",
        "write A",
        "Writes the output symbol when the action is complete.",
    ),
    keyword("priority", "priority 2", "Higher goes first."),
    keyword(
        "weight",
        "weight 0.5",
        "Its share among equals where chance decides.",
    ),
    keyword(
        "time",
        "time exponential 2 s",
        "Fires this long after it became enabled.",
    ),
    keyword(
        "servers",
        "servers many",
        "How many of its firings may go on at once.",
    ),
    keyword(
        "within",
        "within 10 s",
        "The action has failed when it takes longer.",
    ),
];

/// The keywords that can begin a line: inside a transition those of its lines, too.
pub fn keywords(in_transition: bool) -> impl Iterator<Item = &'static Keyword> {
    let fits = move |keyword: &&Keyword| in_transition || DECLARATIONS.contains(&keyword.word);
    KEYWORDS.iter().filter(fits)
}

/// The entry of a keyword.
#[must_use]
pub fn keyword_called(word: &str) -> Option<&'static Keyword> {
    KEYWORDS.iter().find(|keyword| keyword.word == word)
}

/// Whether a keyword begins a line of a transition.
#[must_use]
pub fn is_clause(word: &str) -> bool {
    CLAUSES.contains(&word)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use ctos::diagnostic::Source;

    use super::*;
    use crate::text::parse;

    const PAGE: &str = include_str!("../../../../docs/net-text.md");

    #[test]
    fn the_table_has_every_keyword_of_the_parser_and_no_other() {
        let table: BTreeSet<&str> = KEYWORDS.iter().map(|keyword| keyword.word).collect();
        let parser: BTreeSet<&str> = DECLARATIONS.iter().chain(&CLAUSES).copied().collect();
        assert_eq!(table, parser);
        assert_eq!(table.len(), KEYWORDS.len());
    }

    #[test]
    fn every_form_in_the_table_is_read() {
        for keyword in KEYWORDS {
            let text = match keyword.word {
                "net" => format!("{}\n", keyword.form),
                "end" | "subnet" => "net n\nsubnet NAME(a, b)\nend\n".to_owned(),
                "use" => format!("net n\nsubnet NAME(a, b)\nend\n{}\n", keyword.form),
                // There is no such file here.
                "include" => continue,
                word if is_clause(word) => format!("net n\ntransition t\n  {}\n", keyword.form),
                _ => format!("net n\n{}\n", keyword.form),
            };
            assert!(parse(&Source::new("form", text.clone())).is_ok(), "{text}");
        }
    }

    /// The code of the first column of the page's tables.
    fn forms() -> Vec<&'static str> {
        let rows = PAGE.lines().filter_map(|line| line.strip_prefix("| `"));
        rows.filter_map(|row| row.split(" | ").next())
            .flat_map(|cell| cell.trim_end_matches('`').split("`, `"))
            .collect()
    }

    #[test]
    fn the_page_has_every_keyword_and_every_line_on_it_is_read() {
        let blocks = PAGE.split("```").skip(1).step_by(2).collect::<String>();
        for keyword in KEYWORDS {
            let begins = |line: &str| line.split([' ', '(']).next() == Some(keyword.word);
            let there = forms().iter().any(|form| begins(form))
                || blocks.lines().any(|line| begins(line.trim_start()));
            assert!(there, "docs/net-text.md says nothing of `{}`", keyword.word);
        }
        let mut read = 0;
        for form in forms() {
            let word = form.split(' ').next().unwrap_or_default();
            let text = match word {
                "net" => format!("{form}\n"),
                _ if is_clause(word) => format!("net n\ntransition t\n  {form}\n"),
                _ if DECLARATIONS.contains(&word) => format!("net n\n{form}\n"),
                _ => continue,
            };
            read += 1;
            assert!(parse(&Source::new("page", text.clone())).is_ok(), "{text}");
        }
        assert!(read > 20, "only {read} lines of the page were found");
    }
}
