//! `ctos ways`: what the Coordinators of a running app believe of the ways of each step.

use std::time::Duration;

use clap::Args;
use cli_common::{
    exit,
    remote::{self, RemoteArgs},
    show,
    table::{self, left, right},
};
use coordinators::{
    dom::{self, GetData, ListData},
    strategy::shown::{CHOICES, Choices},
};

/// Arguments.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos ways
  ctos ways --json | jq '.\"push aside\".figures'")]
pub struct WaysArgs {
    /// The data object manager, a task with the handler `coordinators.dom`
    #[arg(default_value = "dom", value_name = "TASK")]
    pub dom: String,
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// How long the task may take.
const DEADLINE: Duration = Duration::from_secs(5);

/// Runs the command.
#[must_use]
pub fn run(args: &WaysArgs) -> u8 {
    let asked = args.remote.connect().and_then(|mut client| {
        let all = client.call(&args.dom, ListData {}, DEADLINE)?;
        let has = |object: &dom::DataObject| object.name == CHOICES && object.bytes.is_some();
        if !all.iter().any(has) {
            return Ok(None);
        }
        let name = CHOICES.to_owned();
        client.call(&args.dom, GetData { name }, DEADLINE).map(Some)
    });
    let choices = match asked {
        Ok(bytes) => bytes.map_or_else(|| Ok(Choices::new()), |bytes| dom::typed(CHOICES, &bytes)),
        Err(error) => return remote::failed_for(&[&args.dom], &error),
    };
    match choices {
        Ok(choices) => print(&choices, args.json),
        Err(error) => {
            show::say(&format!("error: {error}"));
            exit::FAILED
        }
    }
}

fn print(choices: &Choices, json: bool) -> u8 {
    let text = match json {
        true => serde_json::json!(choices).to_string(),
        false if choices.is_empty() => {
            show::say("no Coordinator has chosen among several ways yet");
            return exit::OK;
        }
        false => lines(choices, table::width()).join("\n"),
    };
    // A reader that went away has what it wanted.
    let _ = show::data(&text);
    exit::OK
}

/// A row for each way; the one that was chosen last is marked.
fn lines(choices: &Choices, width: usize) -> Vec<String> {
    let columns = [
        left("STEP"),
        left("WAY"),
        left("CHOSEN"),
        right("SUCCESS"),
        right("COST"),
        right("TRIED"),
    ];
    let rows = choices.iter().flat_map(|(step, shown)| {
        shown.figures.iter().map(move |figures| {
            let is_chosen = shown.chosen.as_ref() == Some(&figures.name);
            vec![
                step.clone(),
                figures.name.clone(),
                if is_chosen { "yes" } else { "" }.to_owned(),
                format!("{:.2}", figures.chance),
                format!("{:.1} s", figures.cost),
                figures.trials.to_string(),
            ]
        })
    });
    let rows: Vec<Vec<String>> = rows.collect();
    table::lines(&columns, &rows, width)
}

#[cfg(test)]
mod tests {
    use coordinators::strategy::{Figures, shown::Shown};

    use super::*;

    #[test]
    fn each_way_has_a_row_with_its_numbers_and_the_chosen_one_is_marked() {
        let figures = |name: &str, chance, trials| Figures {
            name: name.to_owned(),
            trials,
            chance,
            cost: 1.6,
        };
        let shown = Shown {
            chosen: Some("arch".to_owned()),
            figures: vec![figures("arch", 2.0 / 3.0, 1), figures("line", 0.5, 0)],
        };
        let choices = Choices::from([("transfer".to_owned(), shown)]);
        let words = |line: &String| line.split_whitespace().collect::<Vec<_>>().join(" ");
        let lines: Vec<String> = lines(&choices, 80).iter().map(words).collect();
        assert_eq!(
            lines,
            [
                "STEP WAY CHOSEN SUCCESS COST TRIED",
                "transfer arch yes 0.67 1.6 s 1",
                "transfer line 0.50 1.6 s 0"
            ]
        );
    }
}
