//! The numbers of an answer as a person reads them: with names and units, matrices as matrices. They are rounded to six
//! digits; all digits stand in the variables and in what a script gets.

use sorma::describe::{Layout, Part, Shape};

/// Digits that are shown of a number.
const DIGITS: i32 = 6;
/// Numbers in a line when nothing is known about them.
const PER_LINE: usize = 8;

/// The lines for the floats of an answer.
pub(crate) fn floats(layout: &Layout, floats: &[f64]) -> Vec<String> {
    trimmed(match layout.floats(floats) {
        Some(parts) => told(&parts, &|numbers| rounded(numbers)),
        None => plain("numbers", &rounded(floats)),
    })
}

/// The lines for the whole numbers of an answer.
pub(crate) fn ints(layout: &Layout, ints: &[i64]) -> Vec<String> {
    let digits = |numbers: &[i64]| numbers.iter().map(ToString::to_string).collect();
    trimmed(match layout.ints(ints) {
        Some(parts) => told(&parts, &digits),
        None => plain("whole numbers", &digits(ints)),
    })
}

fn trimmed(lines: Vec<String>) -> Vec<String> {
    let lines = lines.into_iter();
    lines.map(|line| line.trim_end().to_owned()).collect()
}

/// Numbers of which nothing is known.
fn plain(what: &str, numbers: &[String]) -> Vec<String> {
    match numbers {
        [] => Vec::new(),
        few if few.len() <= PER_LINE => vec![format!("{what}: {}", few.join("  "))],
        many => {
            let rows: Vec<Vec<String>> = many.chunks(PER_LINE).map(<[String]>::to_vec).collect();
            let head = format!("{} {what}", many.len());
            [vec![head], table(&rows)].concat()
        }
    }
}

fn told<N>(parts: &[(&Part, &[N])], digits: &dyn Fn(&[N]) -> Vec<String>) -> Vec<String> {
    let mut lines = Vec::new();
    let mut named: Vec<[String; 3]> = Vec::new();
    for (part, numbers) in parts {
        match &part.shape {
            Shape::Named(names) => {
                // Of different kinds, and rounded each by itself.
                let pairs = names.iter().zip(numbers.chunks(1));
                named.extend(pairs.map(|(name, number)| {
                    [name.clone(), digits(number).join(""), part.unit.clone()]
                }));
            }
            Shape::Matrix { name, columns, .. } => {
                lines.append(&mut list(&mut named));
                lines.push(titled(name, &part.unit));
                lines.extend(table(&rows(&digits(numbers), *columns)));
            }
            Shape::Rows(names) => {
                lines.append(&mut list(&mut named));
                let head = names.iter().map(|name| titled(name, &part.unit));
                let mut all = vec![[vec![String::new()], head.collect()].concat()];
                let numbered = rows(&digits(numbers), names.len()).into_iter().enumerate();
                all.extend(numbered.map(|(at, row)| [vec![(at + 1).to_string()], row].concat()));
                if all.len() > 1 {
                    lines.extend(table(&all));
                }
            }
        }
    }
    lines.append(&mut list(&mut named));
    lines
}

fn rows(numbers: &[String], columns: usize) -> Vec<Vec<String>> {
    let rows = numbers.chunks(columns.max(1));
    rows.map(<[String]>::to_vec).collect()
}

fn titled(name: &str, unit: &str) -> String {
    match unit {
        "" => name.to_owned(),
        unit => format!("{name} ({unit})"),
    }
}

/// Names with their numbers and units, a line each.
fn list(named: &mut Vec<[String; 3]>) -> Vec<String> {
    let longest = named.iter().map(|[name, ..]| name.chars().count()).max();
    let (names, rest): (Vec<String>, Vec<[String; 2]>) = std::mem::take(named)
        .into_iter()
        .map(|[name, number, unit]| (name, [number, unit]))
        .unzip();
    let rows: Vec<Vec<String>> = rest
        .iter()
        .map(|[number, _]| vec![number.clone()])
        .collect();
    let longest = longest.unwrap_or_default();
    let lines = names.iter().zip(table(&rows)).zip(&rest);
    lines
        .map(|((name, number), [_, unit])| format!("{name:longest$}{number} {unit}"))
        .collect()
}

/// Rows of cells below one another, numbers by their decimal points.
fn table(rows: &[Vec<String>]) -> Vec<String> {
    // Before the point, and from the point on.
    let parts = |cell: &str| {
        let is_number = cell.ends_with(|last: char| last.is_ascii_digit());
        let point = cell.find('.').filter(|_| is_number);
        let before = point.unwrap_or(cell.len());
        let count = |text: Option<&str>| text.map_or(0, |text| text.chars().count());
        (count(cell.get(..before)), count(cell.get(before..)))
    };
    let columns = rows.iter().map(Vec::len).max().unwrap_or_default();
    let widths: Vec<(usize, usize)> = (0..columns)
        .map(|column| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            let (before, after): (Vec<usize>, Vec<usize>) = cells.map(|cell| parts(cell)).unzip();
            let most = |all: Vec<usize>| all.into_iter().max().unwrap_or_default();
            (most(before), most(after))
        })
        .collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, (before, after))| {
            let (own_before, own_after) = parts(cell);
            let (left, right) = (before - own_before, after - own_after);
            format!("  {:left$}{cell}{:right$}", "", "")
        });
        cells.collect::<String>()
    };
    rows.iter().map(line).collect()
}

/// Numbers of one kind, rounded as the largest of them asks for.
fn rounded(numbers: &[f64]) -> Vec<String> {
    let sizes = numbers.iter().filter(|number| number.is_finite());
    let largest = sizes.fold(0.0_f64, |most, number| most.max(number.abs()));
    numbers
        .iter()
        .map(|number| match number {
            number if !number.is_finite() => format!("{number}"),
            number if (1e-4..1e7).contains(&largest) || largest == 0.0 => fixed(*number, largest),
            number => format!("{number:.5e}"),
        })
        .collect()
}

/// A number beside others of which the largest is `largest`.
fn fixed(number: f64, largest: f64) -> String {
    let mut decimals = 0;
    // The digits before the point of the largest count too.
    while decimals < DIGITS + 4 && largest * 10_f64.powi(decimals) < 10_f64.powi(DIGITS - 1) {
        decimals += 1;
    }
    let decimals = usize::try_from(decimals).unwrap_or_default();
    let text = format!("{number:.decimals$}");
    let text = match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.'),
        false => &text,
    };
    match text {
        "-0" => "0".to_owned(),
        text => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(layout: &str, numbers: &[f64]) -> String {
        floats(&layout.parse().unwrap(), numbers).join("\n")
    }

    #[test]
    fn names_have_their_numbers_and_units() {
        let text = shown("q1 q2: rad; took: s", &[0.1 + 0.2, -12.0, 1.25]);
        assert_eq!(text, "q1      0.3  rad\nq2    -12    rad\ntook    1.25 s");
    }

    #[test]
    fn a_matrix_is_a_matrix_and_rounding_does_not_show() {
        let numbers = [1.0, 6.1e-17, 0.4521, -0.0, 1.0, -0.150_05];
        let text = shown("T 2x3: m", &numbers);
        assert_eq!(text, "T (m)\n  1  0   0.4521\n  0  1  -0.15005");
    }

    #[test]
    fn rows_have_a_head_and_no_rows_are_nothing() {
        let text = shown("* u v: px", &[1.5, 2.0, 310.25, 4.0]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3);
        assert!(
            lines[0].contains("u (px)") && lines[0].contains("v (px)"),
            "{text}"
        );
        assert!(
            lines[2].starts_with("  2  ") && lines[2].contains("310.25"),
            "{text}"
        );
        assert_eq!(shown("* u v: px", &[]), "");
    }

    #[test]
    fn numbers_that_nothing_is_known_about_stand_there_all_the_same() {
        assert_eq!(shown("", &[1.0, f64::NAN, 0.25]), "numbers: 1  NaN  0.25");
        let many: Vec<f64> = (0..20_u8).map(f64::from).collect();
        let text = shown("q1: rad", &many);
        assert!(
            text.starts_with("20 numbers\n") && text.lines().count() == 4,
            "{text}"
        );
        assert_eq!(ints(&Layout::default(), &[3, -4]), ["whole numbers: 3  -4"]);
    }

    #[test]
    fn very_small_and_very_large_numbers_keep_their_digits() {
        assert_eq!(shown("a", &[1.234_567_89e-9]), "a  1.23457e-9");
        assert_eq!(shown("a", &[0.001_234_567_8]), "a  0.00123457");
        assert_eq!(
            shown("a b: N", &[1e6, 0.25]),
            "a  1000000    N\nb        0.25 N"
        );
    }
}
