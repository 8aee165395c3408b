//! The one way in which net text is laid out. Works on tokens: every name, number and comment stays as it
//! was written, so a file means the same before and after.

use ctos::diagnostic::{Finding, Findings, Source};

use super::{
    keywords::CLAUSES,
    line::{self, Symbol, Token},
};
use crate::enough::enough;

/// Blanks per level.
const INDENT: usize = 2;

/// A line as it will be.
struct Row {
    /// Blanks before it.
    indent: usize,
    statement: String,
    comment: String,
}

impl Row {
    fn is_blank(&self) -> bool {
        self.statement.is_empty() && self.comment.is_empty()
    }

    fn width(&self) -> usize {
        self.indent + self.statement.chars().count()
    }

    /// Whether a comment follows a statement.
    fn trails(&self) -> bool {
        !self.statement.is_empty() && !self.comment.is_empty()
    }
}

/// Lays a text out: declarations at the margin, clauses below them, lines of a subnet one level deeper.
/// There is one blank between words and at most one empty line. Comments of successive lines are
/// aligned.
///
/// # Errors
/// What cannot be cut into words and numbers.
pub fn formatted(source: &Source) -> Result<String, Findings> {
    let rows = rows(source)?;
    let mut out = String::new();
    let mut blank = false;
    let mut index = 0;
    while let Some(row) = rows.get(index) {
        if row.is_blank() {
            blank = !out.is_empty();
            index += 1;
            continue;
        }
        if std::mem::take(&mut blank) {
            out.push('\n');
        }
        // Lines whose comments stand below each other.
        let together = rows.get(index..).unwrap_or_default();
        let together = together
            .iter()
            .take_while(|row| row.trails())
            .count()
            .max(1);
        let block = rows.get(index..index + together).unwrap_or_default();
        let column = block.iter().map(Row::width).max().unwrap_or_default() + INDENT;
        for row in block {
            push(&mut out, row, column);
        }
        index += together;
    }
    Ok(out)
}

fn push(out: &mut String, row: &Row, column: usize) {
    out.extend(std::iter::repeat_n(' ', row.indent));
    out.push_str(&row.statement);
    if row.trails() {
        out.extend(std::iter::repeat_n(' ', column - row.width()));
    }
    out.push_str(&row.comment);
    out.push('\n');
}

fn rows(source: &Source) -> Result<Vec<Row>, Findings> {
    let mut findings = Findings::new();
    let mut rows = Vec::new();
    let (mut start, mut in_subnet, mut in_transition) = (0, false, false);
    for with_end in source.text().split_inclusive('\n') {
        let text = with_end.trim_end_matches(['\n', '\r']);
        let comment_at = line::comment(text).unwrap_or(text.len());
        let comment = text.get(comment_at..).unwrap_or_default().trim_end();
        let tokens = line::cut(source, text, start).map_err(|bad| {
            Finding::error("pnt::text::symbol", bad.message).at(source.at(bad.range))
        });
        start += with_end.len();
        let Some(tokens) = findings.keep(tokens) else {
            if enough(&findings) {
                break;
            }
            continue;
        };
        let keyword = match tokens.first() {
            Some(Token {
                symbol: Symbol::Name(name),
                ..
            }) => name.as_str(),
            _ => "",
        };
        let clause = CLAUSES.contains(&keyword) && in_transition;
        let margin = match keyword {
            "subnet" | "end" => 0,
            _ => usize::from(in_subnet),
        };
        let level = if tokens.is_empty() {
            // A comment by itself stays with the lines that it was indented with.
            let indented = text.starts_with([' ', '\t']);
            margin
                + usize::from(indented && (in_transition || in_subnet) && margin == 0)
                + usize::from(indented && in_transition && in_subnet)
        } else {
            margin + usize::from(clause)
        };
        if !tokens.is_empty() {
            in_transition = clause || keyword == "transition";
            in_subnet = match keyword {
                "subnet" => true,
                "end" => false,
                _ => in_subnet,
            };
        }
        rows.push(Row {
            indent: level * INDENT,
            statement: statement(&tokens),
            comment: comment.to_owned(),
        });
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(rows)
    }
}

/// The words of a line with the blanks that belong between them.
fn statement(tokens: &[Token]) -> String {
    let mut out = String::new();
    let mut before: Option<&Symbol> = None;
    for token in tokens {
        if before.is_some_and(|before| is_apart(before, &token.symbol)) {
            out.push(' ');
        }
        out.push_str(
            token
                .source
                .text()
                .get(token.range.clone())
                .unwrap_or_default(),
        );
        before = Some(&token.symbol);
    }
    out
}

/// Whether a blank stands between two symbols.
fn is_apart(before: &Symbol, after: &Symbol) -> bool {
    let joins_next = matches!(before, Symbol::Mark("(" | "*" | "@" | "."));
    let joins_last = matches!(after, Symbol::Mark("," | "(" | ")" | "*" | "@" | "."));
    !joins_next && !joins_last
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{super::tests::a_draft, *};
    use crate::text::parse;

    fn laid_out(text: &str) -> String {
        formatted(&Source::new("a.net", text)).unwrap_or_else(|f| panic!("{f}"))
    }

    #[test]
    fn blanks_are_settled_and_comments_stay() {
        let text = "\n\n  net   n   \"a # title\"#first\r\n\n\n# a place\nplace a=1 ,b   # two\n   place c  # three\n\ntransition t # it\n in a * 2,b@m\n # what it does\n   send x . y( p,q->r )\n  when not   f\n# margin\nout \"p 1\"   \nsubnet s( a,b )\nplace p\n# here\ntransition u\nin p\n  # inside\nend\nuse s(1 , x) as  y\n\n";
        let wanted = "net n \"a # title\"  #first

# a place
place a = 1, b  # two
place c         # three

transition t  # it
  in a*2, b@m
  # what it does
  send x.y(p, q -> r)
  when not f
# margin
  out \"p 1\"
subnet s(a, b)
  place p
  # here
  transition u
    in p
    # inside
end
use s(1, x) as y
";
        assert_eq!(laid_out(text), wanted);
        assert_eq!(laid_out(wanted), wanted);
    }

    #[test]
    fn what_cannot_be_cut_is_told_and_nothing_is_laid_out() {
        let found = formatted(&Source::new("a.net", "net n\nplace \"a\nplace ?\n")).unwrap_err();
        assert_eq!(found.iter().count(), 2, "{found}");
    }

    /// A text with other blanks and with comments.
    fn disturbed(text: &str, choices: &[u8]) -> String {
        let mut choices = choices.iter().copied().cycle();
        let mut out = String::new();
        for line in text.lines() {
            match choices.next().unwrap_or(0) % 8 {
                0 => out.push_str("\n\n"),
                1 => out.push_str("# by itself\n"),
                2 => out.push_str("\t  # indented \n"),
                3 => out.push_str("     "),
                _ => {}
            }
            out.push_str(line);
            match choices.next().unwrap_or(0) % 4 {
                0 => out.push_str("#x"),
                1 => out.push_str("    # \"y"),
                2 => out.push_str("  \r"),
                _ => {}
            }
            out.push('\n');
        }
        out
    }

    proptest! {
        #[test]
        fn a_text_means_the_same_laid_out_and_laying_out_again_changes_nothing(
            draft in a_draft(),
            choices in prop::collection::vec(any::<u8>(), 1..20),
        ) {
            let text = disturbed(&draft.to_string(), &choices);
            let once = laid_out(&text);
            prop_assert_eq!(parse(&Source::new("once", once.clone())).unwrap(), draft);
            prop_assert_eq!(&laid_out(&once), &once);
            let comments = |text: &str| text.matches('#').count();
            prop_assert_eq!(comments(&once), comments(&text));
        }

        #[test]
        fn no_text_makes_it_panic(text in "\\PC*") {
            let _ = formatted(&Source::new("any", text));
        }
    }
}
