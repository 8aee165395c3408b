//! Answers of objects that stand in the documents are what the objects answer, where they answer without an app. The
//! document may round and lay out as it likes; the numbers are these.

use std::fs;

use cli::scott::services;
use sorma::{Reply, Sorm};

use crate::{common::root, lines::pages};

/// What separates an explanation from the request before it.
const GAP: &str = "   ";

/// The document may round to so much of a number.
const ROUNDED: f64 = 1e-5;

/// Answers that are other ones each time, by their first words, and how many of their numbers are the same.
const STAMPED: &[(&str, usize)] = &[
    // Number of the record, time on the writer's clock, age, writer's process, number of slots lost, ...
    ("shmem_r.ball EXEC", 2),
    // Of a daemon elsewhere.
    ("shmem_far.ball EXEC", 0),
];

/// What a document says that a request is answered.
struct Shown {
    request: String,
    numbers: Vec<f64>,
    /// All of the answer, or numbers of it that are spoken of.
    is_whole: bool,
}

fn numbers(text: &str) -> Vec<f64> {
    let words = text.split(|letter: char| letter.is_whitespace() || ",:;()".contains(letter));
    words.filter_map(|word| word.parse().ok()).collect()
}

/// The numbers with a unit in an explanation; others are names and counts.
fn measured(text: &str) -> Vec<f64> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let pairs = words.windows(2);
    let units = ["s", "m", "rad", "N"];
    let with_unit =
        pairs.filter(|pair| units.contains(&pair[1].trim_end_matches([',', ':', ';', '.'])));
    with_unit.filter_map(|pair| pair[0].parse().ok()).collect()
}

/// The request as a script has it: at the prompt numbers need neither keyword nor count, and daemons are elsewhere.
fn plain(request: &str) -> String {
    let words: Vec<String> = request
        .split_whitespace()
        .map(|word| match word.split_once('@') {
            Some((name, _)) if word.len() > 1 => name.to_owned(),
            _ => word.to_owned(),
        })
        .collect();
    let spoken = !words.iter().any(|word| word == "FMSG");
    let first = words.iter().rposition(|word| word.parse::<f64>().is_err());
    let (head, given) = words.split_at(first.map_or(0, |at| at + 1));
    match spoken && !given.is_empty() && words.get(1).is_some_and(|word| word == "EXEC") {
        true => format!(
            "{} FMSG {} {}",
            head.join(" "),
            given.len(),
            given.join(" ")
        ),
        false => words.join(" "),
    }
}

fn is_request(line: &str) -> bool {
    let method = line.split_whitespace().nth(1);
    method.is_some_and(|word| ["EXEC", "CTRL"].contains(&word)) && !line.contains(" | ")
}

/// The requests of a block in their order, each with the answer that it shows, if it does.
fn shown(block: &[&str]) -> Vec<Shown> {
    let mut all: Vec<Shown> = Vec::new();
    // What follows is an answer.
    let mut answers = false;
    for line in block {
        let typed = line
            .strip_prefix("scott ")
            .and_then(|line| line.split_once("> "));
        let told = line.strip_prefix("$ scott ");
        let line = typed.map_or(*line, |(_, typed)| typed);
        answers = match line.starts_with("$ ") || is_request(line) {
            true => told.is_some() || typed.is_some(),
            false => answers,
        };
        if let Some(commands) = told {
            // What `-c` is given stands in quotes of one kind.
            for part in commands.split("-c ").skip(1) {
                let quote = part.chars().next().unwrap_or_default();
                let request = part.get(1..).and_then(|part| part.split_once(quote));
                all.extend(request.map(|(request, _)| Shown {
                    request: request.to_owned(),
                    numbers: Vec::new(),
                    is_whole: false,
                }));
            }
        } else if is_request(line) {
            let (request, answer) = match line.split_once("-> ") {
                Some((request, answer)) => (request, Some(answer)),
                None => (line, None),
            };
            let (request, words) = request.split_once(GAP).unwrap_or((request, ""));
            let answered = answer.map(|answer| format!("x RET 0 {answer}").parse::<Reply>());
            let answered = answered.map(|reply| of_reply(&reply.unwrap()));
            all.push(Shown {
                request: request.trim().to_owned(),
                is_whole: answered.is_some(),
                numbers: answered.unwrap_or_else(|| measured(words)),
            });
        } else if let Some(last) = all.last_mut().filter(|_| answers) {
            // Lines of an answer follow what was asked at a prompt.
            let numbers = match line.parse::<Reply>() {
                Ok(reply) => of_reply(&reply),
                Err(_) => numbers(line),
            };
            last.is_whole |= !numbers.is_empty();
            last.numbers.extend(numbers);
        }
    }
    all
}

fn of_reply(reply: &Reply) -> Vec<f64> {
    let ints = reply.body.ints.iter().map(|int| *int as f64);
    reply.body.floats.iter().copied().chain(ints).collect()
}

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= ROUNDED * a.abs().max(b.abs()).max(0.1)
}

/// What is wrong with the answer that a document shows; `None` also where only an app would answer.
fn wrong(sorm: &Sorm, shown: &Shown, seen: &mut usize) -> Option<String> {
    if shown.request.contains('$') {
        return None;
    }
    let request = plain(&shown.request);
    let reply: Reply = sorm.dispatch(&request).parse().unwrap();
    let answered = of_reply(&reply);
    let stamped = STAMPED.iter().find(|(start, _)| request.starts_with(start));
    let certain = stamped.map_or(usize::MAX, |(_, certain)| *certain);
    let agrees = if shown.is_whole {
        let pairs = shown.numbers.iter().zip(&answered).take(certain);
        let long = shown.numbers.len() == answered.len() || stamped.is_some();
        *seen += 1;
        long && pairs.clone().all(|(a, b)| same(*a, *b))
    } else {
        // Of a request's own numbers an explanation may speak, too.
        let asked = numbers(&request);
        let known = |number: &f64| {
            answered
                .iter()
                .chain(&asked)
                .any(|other| same(*number, *other))
        };
        let is_refused = !reply.body.is_ok();
        *seen += usize::from(!is_refused && !shown.numbers.is_empty());
        is_refused || shown.numbers.iter().all(known)
    };
    (!agrees).then(|| {
        format!(
            "{request} answers {answered:?}, and not {:?}",
            shown.numbers
        )
    })
}

fn in_page(text: &str, seen: &mut usize) -> Vec<String> {
    let mut found = Vec::new();
    let (mut block, mut is_text) = (None::<Vec<&str>>, false);
    for line in text.lines() {
        if let Some(kind) = line.strip_prefix("```") {
            if let Some(block) = block.take() {
                if !is_text {
                    continue;
                }
                let sorm = services::manager(&[]).unwrap();
                let wrong = |one: &Shown| wrong(&sorm, one, seen);
                found.extend(shown(&block).iter().filter_map(wrong));
            } else {
                (block, is_text) = (Some(Vec::new()), kind == "text");
            }
        } else if let Some(block) = &mut block {
            block.push(line);
        }
    }
    found
}

#[test]
fn answers_of_objects_in_the_documents_are_what_the_objects_answer() {
    let mut found = Vec::new();
    let mut seen = 0;
    for page in pages() {
        let text = fs::read_to_string(root().join(&page)).unwrap();
        let wrong = in_page(&text, &mut seen);
        found.extend(wrong.into_iter().map(|wrong| format!("{page}: {wrong}")));
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
    assert!(seen >= 4, "{seen} answers");
}

#[test]
fn an_answer_with_a_wrong_number_is_found() {
    let fkine = "scott x> kin EXEC fkine 0 0 0 0 0 0\nbase_T_6 (m)\n  1  0  0   0.4521\n  0  1  0  -0.15005\n  0  0  1   1.10363\n  0  0  0   1";
    for (block, is_right) in [
        (fkine.to_owned(), true),
        (fkine.replace("0.4521", "0.4522"), false),
        (fkine.replace("  0  0  0   1", ""), false),
        ("traj EXEC TMSG rest FMSG 11 2 0 0 1 0.5 1 2 4 4 0 0   takes 1.25 s".to_owned(), true),
        ("traj EXEC TMSG rest FMSG 11 2 0 0 1 0.5 1 2 4 4 0 0   takes 1.35 s".to_owned(), false),
        ("$ scott x -c \"queue.j EXEC put 'a' FMSG 2 0.5 0.1\"\n$ scott x -c \"queue.j@d EXEC take\"\nqueue.j@d RET 0 TMSG a FMSG 2 0.5 0.1".to_owned(), true),
        ("$ scott x -c \"queue.j EXEC put 'a' FMSG 2 0.5 0.2\"\n$ scott x -c \"queue.j@d EXEC take\"\nqueue.j@d RET 0 TMSG a FMSG 2 0.5 0.1".to_owned(), false),
    ] {
        let text = format!("```text\n{block}\n```\n");
        let found = in_page(&text, &mut 0);
        assert_eq!(found.is_empty(), is_right, "{block}: {found:?}");
    }
}
