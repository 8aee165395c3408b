//! What a page may ask, and what it is told. Knows nothing of HTTP, and nothing of who meets the lines.

use std::collections::{BTreeMap, BTreeSet};

use futures_util::future::BoxFuture;
use serde_json::{Value, json};
use sorma::{ClassInfo, Reply};

use super::{
    logic::{Expression, Value as Named, Worth},
    script::{Panel, Widget},
};
use cli_common::page::{Door, Right};

use crate::replies;

/// Who meets the lines of a page. What comes back is a reply, whatever happens.
pub(super) trait Objects: Send + Sync + 'static {
    /// Has a line met.
    fn ask(&self, line: String) -> BoxFuture<'static, String>;
}

/// Some panels, and who meets their lines.
pub(super) struct Service {
    name: String,
    panels: Vec<Panel>,
    /// The lines that change nothing: those by which the panels show how it stands.
    looks: BTreeSet<String>,
    objects: Box<dyn Objects>,
    pub(super) door: Door,
}

impl Service {
    pub(super) fn new(name: &str, panels: Vec<Panel>, door: Door, objects: impl Objects) -> Self {
        let looks = panels.iter().flat_map(|panel| &panel.widgets);
        let looks = looks.flat_map(Widget::looks).collect();
        Self {
            name: name.to_owned(),
            panels,
            looks,
            objects: Box::new(objects),
            door,
        }
    }

    /// Whether a line is one of those by which the panels show how it stands.
    pub(super) fn is_look(&self, line: &str) -> bool {
        self.looks.contains(line)
    }

    /// What an object answers to a line, for a page.
    pub(super) async fn ask(&self, line: &str) -> Value {
        match self.objects.ask(line.to_owned()).await.parse::<Reply>() {
            Ok(reply) => replies::as_json(&reply, None),
            Err(error) => {
                json!({ "ret": 7, "text": "", "reports": [{ "text": error.to_string() }] })
            }
        }
    }

    /// What follows from the values of a panel now: for each widget, in their order, whether it can be used, and
    /// what it shows. Nothing when there is no panel of that number.
    pub(super) async fn follows(&self, number: usize) -> Option<Value> {
        let panel = self.panels.get(number)?;
        let mut answers: BTreeMap<&str, Option<Reply>> = BTreeMap::new();
        for Named { ask, .. } in &panel.values {
            if !answers.contains_key(ask.as_str()) {
                let reply = self.objects.ask(ask.clone()).await.parse().ok();
                answers.insert(ask, reply);
            }
        }
        let worth = panel.values.iter().filter_map(|value| {
            let reply = answers.get(value.ask.as_str())?.as_ref()?;
            Some((value.name.clone(), value.of(&reply.body)?))
        });
        let values: BTreeMap<String, Worth> = worth.collect();
        // What was checked when the panel was read.
        let of = |text: &str| Expression::read(text, &panel.values).ok()?.worth(&values);
        let widgets = panel.widgets.iter().map(|widget| {
            let (when, is) = widget.logic();
            // What is not known is not met.
            let on = when.is_none_or(|when| of(when) == Some(Worth::Truth(true)));
            let shown = is.map(|is| of(is).map_or_else(|| "–".to_owned(), |worth| worth.shown()));
            json!({ "on": on, "shown": shown })
        });
        Some(json!(widgets.collect::<Vec<_>>()))
    }

    /// A panel with what its widgets need to know: descriptions and values of options. Nothing when there is none
    /// of that number, from 0.
    pub(super) async fn described(&self, number: usize, right: Right) -> Option<Value> {
        let panel = self.panels.get(number)?;
        let mut classes = None;
        let mut widgets = Vec::new();
        for widget in &panel.widgets {
            let mut value = serde_json::to_value(widget).unwrap_or_default();
            value["finds"] = json!(widget.finds());
            if let Widget::Options { object, .. } = widget {
                if classes.is_none() {
                    classes = Some(self.classes().await);
                }
                let class = object.split(['.', '@']).next().unwrap_or_default();
                let class = class.to_lowercase();
                let mut known = classes.iter().flatten();
                value["class"] = json!(known.find(|info| info.name == class));
                let dump = self.ask(&format!("{object} CTRL -dump")).await;
                value["dump"] = dump["text"].clone();
            }
            widgets.push(value);
        }
        let titles = self.panels.iter().map(|panel| panel.title.as_str());
        Some(json!({
            "name": self.name,
            "title": panel.title,
            "panels": titles.collect::<Vec<_>>(),
            "number": number,
            "follows": !panel.values.is_empty(),
            "every_s": panel.values_every_s,
            "control": right == Right::Control,
            "why": self.door.why_only_look(),
            "widgets": widgets,
        }))
    }

    /// What is known about the classes.
    async fn classes(&self) -> Vec<ClassInfo> {
        let described = self.ask("sorm CTRL -describe").await;
        let lines = described["text"].as_str().unwrap_or_default().lines();
        lines
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::script::{SOME_JOINTS, for_arms};
    use super::*;
    use futures_util::FutureExt as _;

    /// Says every line back.
    struct Echo;

    impl Objects for Echo {
        fn ask(&self, line: String) -> BoxFuture<'static, String> {
            let text = sorma::words::quoted(&line);
            async move { format!("echo RET 0 TMSG {text}") }.boxed()
        }
    }

    #[test]
    fn what_shows_how_it_stands_is_told_from_what_changes_it() {
        let panels = ["puma560.toml", "vss.toml", "pendant.toml"].map(|name| {
            let path = format!("{}/../../configs/panels/{name}", env!("CARGO_MANIFEST_DIR"));
            let source = ctos::diagnostic::Source::read(path.as_ref()).unwrap();
            let arm = ["arm".to_owned()];
            let source = for_arms(&source, &arm, &SOME_JOINTS.map(str::to_owned))
                .pop()
                .unwrap();
            Panel::read(&source, &mut ctos::diagnostic::Findings::new()).unwrap()
        });
        let door = Door {
            anybody_looks: true,
            ..Door::default()
        };
        let service = Service::new("cell", panels.to_vec(), door, Echo);
        assert!(service.is_look("pino EXEC state"));
        assert!(service.is_look("pino EXEC control"));
        assert!(service.is_look("slots.arm EXEC"));
        assert!(service.is_look("dict CTRL -find position.arm."));
        for line in [
            "pino.arm EXEC records",
            "mvpos.arm CTRL -keep on",
            "mvpos.arm EXEC by FMSG 6 0.02 0 0 0 0 0",
            "dict CTRL -add position.arm.a '1 2 3 4 5 6' -save",
            "pino EXEC stop",
            "mvpos EXEC home",
            "pino EXEC state ",
            "spot CTRL -threshold 3",
            "mvpos CTRL -speed {speed}",
            "",
        ] {
            assert!(!service.is_look(line), "{line}");
        }
        let described = service.described(1, Right::Look).now_or_never().flatten();
        let described = described.unwrap();
        assert_eq!(described["control"], false);
        assert_eq!(described["panels"].as_array().unwrap().len(), 3);
        assert_eq!(described["widgets"][0]["dump"], "spot CTRL -dump");
        assert!(
            service
                .described(3, Right::Look)
                .now_or_never()
                .flatten()
                .is_none()
        );
    }

    /// Serves tea.
    struct Bar(&'static str);

    impl Objects for Bar {
        fn ask(&self, _: String) -> BoxFuture<'static, String> {
            let answer = self.0.to_owned();
            async move { answer }.boxed()
        }
    }

    #[test]
    fn what_follows_from_the_values_of_a_panel_is_told_for_each_widget() {
        let text = "title = \"t\"\n[[value]]\nname = \"tea\"\nask = \"bar EXEC\"\nfloat = 1\n\
            [[value]]\nname = \"place\"\nask = \"bar EXEC\"\nword = 1\n\
            [[widget]]\nkind = \"button\"\nlabel = \"Pour\"\nask = \"bar CTRL -tea 2\"\n\
            when = \"tea < 1 and place == 'kitchen'\"\n\
            [[widget]]\nkind = \"value\"\nlabel = \"Cups\"\nis = \"tea / 0.25\"\n";
        let follows = |answer: &'static str| {
            let mut findings = ctos::diagnostic::Findings::new();
            let source = ctos::diagnostic::Source::new("p.toml", text);
            let panel = Panel::read(&source, &mut findings).unwrap();
            assert!(findings.is_empty());
            let service = Service::new("cell", vec![panel], Door::default(), Bar(answer));
            assert!(service.follows(1).now_or_never().flatten().is_none());
            service.follows(0).now_or_never().flatten().unwrap()
        };
        let told = |on: bool, shown: &str| json!([{ "on": on, "shown": null }, { "on": true, "shown": shown }]);
        assert_eq!(
            follows("bar RET 0 TMSG kitchen FMSG 1 0.5"),
            told(true, "2")
        );
        assert_eq!(
            follows("bar RET 0 TMSG garden FMSG 1 0.5"),
            told(false, "2")
        );
        assert_eq!(
            follows("bar RET 0 TMSG kitchen FMSG 1 1.5"),
            told(false, "6")
        );
        // Without an answer nothing follows, and nothing can be pressed.
        assert_eq!(follows("bar RET 7 TDBX gone"), told(false, "–"));
    }
}
