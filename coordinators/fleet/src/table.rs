//! `[fleet]`: how many sites and cells there are, and what each of them is. A site, and a cell, is written once, as the
//! chassis and tasks of any app are; the table stands for so many replicas of it.
//!
//! The names of a replica begin with its own: chassis and tasks of the third cell are `cell3.NAME`. In texts `{cell}`
//! stands for `cell3`, and `{site}` for the site that it belongs to. `on` names a chassis of the replica where it has one.

use std::collections::BTreeMap;

use ctos::{
    config::{Entry, Expander, GeneratedTask, Node, Value},
    diagnostic::{Finding, Findings, Place},
};
use serde::{Deserialize, de::IgnoredAny};

/// The most replicas of a kind: an app has no more chassis.
const MOST: u64 = 65_534;

/// The table `[fleet]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FleetTable {
    /// How many sites there are.
    sites: u64,
    /// How many cells there are, on all sites together.
    cells: u64,
    /// What each site is.
    #[serde(default, rename = "site")]
    _site: Replica,
    /// What each cell is.
    #[serde(default, rename = "cell")]
    _cell: Replica,
}

/// What is written once. Its chassis and tasks are read as those of the app.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Replica {
    #[serde(default, rename = "chassis")]
    _chassis: BTreeMap<String, IgnoredAny>,
    #[serde(default, rename = "task")]
    _task: BTreeMap<String, IgnoredAny>,
}

/// Turns `[fleet]` into chassis and tasks.
#[derive(Debug, Clone, Copy, Default)]
pub struct FleetExpander;

impl Expander for FleetExpander {
    fn expand(&self, _: &Node, _: &mut Findings) -> Vec<GeneratedTask> {
        Vec::new()
    }

    fn tables(&self, table: &Node, findings: &mut Findings) -> Node {
        let Some(FleetTable { sites, cells, .. }) = findings.keep(table.parse()) else {
            return Node::table();
        };
        let most = [("sites", sites, MOST), ("cells", cells, MOST)];
        for (key, count, most) in most {
            if count == 0 || count > most {
                let text = format!("[fleet]: `{key}` is {count}");
                let finding =
                    Finding::error("coordinators::fleet::replicas", text).at(table.locate(key));
                findings.push(finding.help(format!("give from 1 to {most}")));
                return Node::table();
            }
        }
        if sites > cells {
            let text = format!("[fleet]: {sites} sites have {cells} cells");
            let finding =
                Finding::error("coordinators::fleet::replicas", text).at(table.locate("sites"));
            findings.push(finding.help("give at least as many cells as sites"));
            return Node::table();
        }
        let mut made = Made::default();
        for site in 1..=sites {
            let names = [("site", format!("site{site}"))];
            made.replica(table, "site", &names, (site == 1).then_some(&mut *findings));
        }
        for cell in 1..=cells {
            let site = (cell - 1) * sites / cells + 1;
            let names = [
                ("cell", format!("cell{cell}")),
                ("site", format!("site{site}")),
            ];
            made.replica(table, "cell", &names, (cell == 1).then_some(&mut *findings));
        }
        made.tables()
    }
}

/// The task of the same replica as `task` that is called `name` there: `cell3.hand` beside `cell3.agent`.
#[must_use]
pub fn beside(task: &str, name: &str) -> String {
    format!("{}.{name}", replica(task))
}

/// The replica that a task belongs to: `cell3` of `cell3.agent`.
#[must_use]
pub fn replica(task: &str) -> &str {
    task.rsplit_once('.').map_or(task, |(replica, _)| replica)
}

/// Findings without those that differ from an earlier one at the same place in the numbers of replicas only: what is written
/// once for many is told once.
#[must_use]
pub fn told_once(findings: Findings) -> Findings {
    let mut told: Vec<(&'static str, Place, String)> = Vec::new();
    let mut once = Findings::new();
    for finding in findings.into_sorted() {
        if let Some(place) = &finding.place {
            let words = without_numbers(&finding.message);
            let said = (finding.code, place.clone(), words);
            if told.contains(&said) {
                continue;
            }
            told.push(said);
        }
        once.push(finding);
    }
    once
}

/// A text with `cell` and `site` for `cell3` and `site2`.
fn without_numbers(text: &str) -> String {
    let mut words = String::with_capacity(text.len());
    for letter in text.chars() {
        let is_number =
            letter.is_ascii_digit() && ["cell", "site"].iter().any(|one| words.ends_with(one));
        if !is_number {
            words.push(letter);
        }
    }
    words
}

/// What was made so far.
#[derive(Default)]
struct Made {
    chassis: Vec<Entry>,
    tasks: Vec<Entry>,
}

impl Made {
    /// Makes one replica of what stands under `kind`; its own name is the first. What is wrong with all of them alike is
    /// told with the first.
    fn replica(
        &mut self,
        table: &Node,
        kind: &str,
        names: &[(&str, String)],
        mut findings: Option<&mut Findings>,
    ) {
        let (Some(what), Some((_, own))) = (table.get(kind), names.first()) else {
            return;
        };
        let chassis = what.get("chassis").map_or(&[][..], Node::entries);
        let tasks = what.get("task").map_or(&[][..], Node::entries);
        let mut named = |entry: &Entry| Entry {
            key: format!("{own}.{}", entry.key),
            key_place: entry.key_place.clone(),
            value: entry
                .value
                .with_texts(&mut |text, place| filled(text, place, names, findings.as_deref_mut())),
        };
        self.chassis.extend(chassis.iter().map(&mut named));
        for task in tasks {
            let mut task = named(task);
            if let Some(on) = task.value.get("on")
                && let Some(local) = on.as_str().and_then(|on| on.split(['/', ':']).next())
                && chassis.iter().any(|one| one.key == local)
            {
                let on = on.with_texts(&mut |on, _| Some(format!("{own}.{on}")));
                task.value = task.value.with("on", on);
            }
            self.tasks.push(task);
        }
    }

    fn tables(self) -> Node {
        let table = |entries| Node::from(Value::Table(entries));
        let tables = Node::table().with("chassis", table(self.chassis));
        tables.with("task", table(self.tasks))
    }
}

/// A text with names for what stands in braces; `None` where nothing does.
fn filled(
    text: &str,
    place: Option<&Place>,
    names: &[(&str, String)],
    findings: Option<&mut Findings>,
) -> Option<String> {
    if !text.contains('{') {
        return None;
    }
    let mut whole = text.to_owned();
    for (word, name) in names {
        whole = whole.replace(&format!("{{{word}}}"), name);
    }
    let left = whole
        .split_once('{')
        .and_then(|(_, rest)| rest.split_once('}'));
    if let (Some((word, _)), Some(findings)) = (left, findings)
        && word.chars().all(char::is_alphanumeric)
    {
        let said = format!("nothing stands for `{{{word}}}` here");
        let known = names.iter().map(|(word, _)| *word);
        let finding = Finding::error("coordinators::fleet::placeholder", said).at(place.cloned());
        findings.push(finding.suggest(word, known));
    }
    Some(whole)
}

#[cfg(test)]
mod tests {
    use ctos::config::{self, App};

    use super::*;

    const SITES: &str = "
[fleet.site.chassis.office]
[fleet.site.task.operator]
handler = \"h\"
on = \"office\"
args.cells = [\"{site}.x\"]
[fleet.cell.chassis.ws.processors]
servo = {}
[fleet.cell.task.agent]
handler = \"h\"
on = \"ws/servo\"
args = { operator = \"{site}.operator\", me = \"{cell}\" }
[fleet.cell.task.guest]
handler = \"h\"
on = \"desk\"
[chassis.desk]
";

    fn load(counts: &str, sets: &[&str]) -> Result<App, Vec<String>> {
        let text = format!("{counts}{SITES}");
        let files = [("app.toml", text.as_str())];
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        let expanders: [(&'static str, &dyn Expander); 1] = [("fleet", &FleetExpander)];
        config::load_texts(&files, &sets, &expanders).map_err(|found| {
            told_once(found)
                .into_sorted()
                .iter()
                .map(ToString::to_string)
                .collect()
        })
    }

    #[test]
    fn a_cell_is_written_once_and_each_replica_has_names_of_its_own() {
        let app = load("[fleet]\nsites = 2\ncells = 3\n", &[]).unwrap();
        let chassis: Vec<&str> = app.chassis.iter().map(|one| one.name.as_str()).collect();
        let expected = [
            "site1.office",
            "site2.office",
            "cell1.ws",
            "cell2.ws",
            "cell3.ws",
            "desk",
        ];
        assert_eq!(chassis, expected);
        let agent = app.task("cell3.agent").unwrap();
        assert_eq!(
            (agent.chassis.as_str(), agent.processor.as_str()),
            ("cell3.ws", "servo")
        );
        let text = |key: &str| {
            agent
                .args
                .get(key)
                .and_then(Node::as_str)
                .map(str::to_owned)
        };
        assert_eq!(text("operator").as_deref(), Some("site2.operator"));
        assert_eq!(text("me").as_deref(), Some("cell3"));
        assert_eq!(
            app.task("cell1.agent")
                .unwrap()
                .args
                .get("operator")
                .unwrap()
                .as_str(),
            Some("site1.operator")
        );
        assert_eq!(app.task("cell2.guest").unwrap().chassis, "desk");
        // What is written once is found where it is written.
        assert_eq!(agent.on_place.to_string(), "app.toml:14:6");
    }

    #[test]
    fn the_command_line_says_how_many_there_are() {
        let app = load("[fleet]\nsites = 2\ncells = 3\n", &["fleet.cells=30"]).unwrap();
        assert_eq!(app.chassis.len(), 2 + 30 + 1);
    }

    #[test]
    fn what_is_wrong_points_to_where_it_is_written() {
        let first = |counts: &str| {
            load(counts, &[])
                .unwrap_err()
                .first()
                .cloned()
                .unwrap_or_default()
        };
        let none = first("[fleet]\nsites = 2\ncells = 0\n");
        assert!(
            none.starts_with("app.toml:3:1: error: [fleet]: `cells` is 0"),
            "{none}"
        );
        let more = first("[fleet]\nsites = 4\ncells = 3\n");
        assert!(
            more.starts_with("app.toml:2:1: error: [fleet]: 4 sites have 3 cells"),
            "{more}"
        );
        let unknown = first(
            "[fleet]\nsites = 1\ncells = 1\n[fleet.cell.task.t]\nhandler = \"{cel}\"\non = \"desk\"\n",
        );
        assert!(
            unknown.starts_with("app.toml:5:11: error: nothing stands for `{cel}` here"),
            "{unknown}"
        );
        let repeated = load(
            "[fleet]\nsites = 1\ncells = 9\n[fleet.cell.chassis.x]\nrestrat = 1\n",
            &[],
        );
        assert_eq!(repeated.unwrap_err().len(), 1);
        let key = first("[fleet]\nsites = 1\ncells = 1\nsells = 2\n");
        assert!(
            key.starts_with("app.toml:4:1: error: unknown key `sells`"),
            "{key}"
        );
    }
}
