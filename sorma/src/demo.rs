//! The demo classes of the report: `foo` serves a meal, `bar` mixes a drink (SORMA technical report,
//! section 1.5). They are for trying out names, flavors, the dictionary and nested calls without any
//! hardware.

use crate::class::Class;
use crate::description::{ClassInfo, Form};
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::report::Report;
use crate::request::Method;
use crate::sorm::Sorm;
use crate::transport::Transport;
use std::sync::LazyLock;

/// Version of the demo classes.
const VERSION: &str = "1.0";

crate::prototypes! {
    /// What the demo classes report.
    pub mod code {
        NO_TEA = 100, Error, "there is no tea", "set -tea";
    }
}

/// The dictionary that goes with the classes. It has the entries of section 1.5 as printed, and a
/// plain `foo` to derive flavors from, as section 2.1.5 does with `carry`.
pub const DICTIONARY: &str = "\
foo.a -breakfast -where kitchen -tempo presto
foo.b -breakfast -where garden -freshJuice -tempo adagio
bar   -tea 1.5 -ice crushed -lemon 0.3
foo   -transferSpeed 0.8
";

/// Makes the classes known to a manager.
pub fn register(sorm: &Sorm) {
    let meal = Class::new("foo", VERSION, |_, _| Ok(Box::new(Meal::default())));
    sorm.register(meal.described(MEAL.class("foo", VERSION)));
    let bar = Class::new("bar", VERSION, |_, _| Ok(Box::new(Drink::default())));
    let bar = bar.described(DRINK.class("bar", VERSION));
    sorm.register(bar.codes(code::PROTOTYPES));
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![MEAL.class("foo", VERSION), DRINK.class("bar", VERSION)]
}

#[derive(Debug, Clone)]
struct Meal {
    breakfast: bool,
    fresh_juice: bool,
    place: String,
    tempo: String,
    drink: String,
    transfer_speed: f64,
}

impl Default for Meal {
    fn default() -> Self {
        Self {
            breakfast: false,
            fresh_juice: false,
            place: "kitchen".to_owned(),
            tempo: "piano".to_owned(),
            drink: String::new(),
            transfer_speed: 0.5,
        }
    }
}

static MEAL: LazyLock<OptionTable<Meal>> = LazyLock::new(|| {
    OptionTable::new("serves a meal (a demo class)")
        .exec(&[
            Form {
                text: "",
                floats: 0,
                takes: "",
                gives: "what is served, and the floats of the drink if there is one",
                results: "",
                help: "serves the meal",
            },
            Form {
                text: "",
                floats: 6,
                takes: "two places x y z, m",
                gives: "1 float: the speed of the transfer, m/s",
                results: "speed: m/s",
                help: "carries the tray from one place to another",
            },
        ])
        .flag("breakfast", "it is served early", |meal: &mut Meal| {
            &mut meal.breakfast
        })
        .flag("freshJuice", "the juice is pressed now", |meal| {
            &mut meal.fresh_juice
        })
        .choice(
            "where",
            &["kitchen", "garden"],
            "where it is served",
            |meal| &mut meal.place,
        )
        .choice(
            "tempo",
            &["adagio", "piano", "presto"],
            "how fast it is served",
            |meal| &mut meal.tempo,
        )
        .word(
            "drink",
            "OBJECT",
            "the service object that brings the drink; empty for none",
            |meal| &mut meal.drink,
        )
        .float(
            "transferSpeed",
            0.0..=1.0,
            "m/s",
            "speed at which the tray is carried",
            |meal| &mut meal.transfer_speed,
        )
});

impl ServiceObject for Meal {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let form = MEAL.form(io)?;
        io.floats.clear();
        let meal = self;
        if form.floats == 6 {
            io.floats.push(meal.transfer_speed);
            return Ok(());
        }
        if !meal.drink.is_empty() {
            let drink = cx.call(&meal.drink, Method::Exec, Transport::default(), io)?;
            io.floats = drink.floats;
        }
        let what = if meal.breakfast {
            "breakfast"
        } else {
            "dinner"
        };
        let juice = if meal.fresh_juice {
            ", fresh juice"
        } else {
            ""
        };
        io.text = format!("{what} in the {}, {}{juice}", meal.place, meal.tempo);
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        MEAL.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        MEAL.dump(self)
    }
}

#[derive(Debug, Clone)]
struct Drink {
    tea: f64,
    lemon: f64,
    ice: String,
}

impl Default for Drink {
    fn default() -> Self {
        Self {
            tea: 0.0,
            lemon: 0.0,
            ice: "none".to_owned(),
        }
    }
}

static DRINK: LazyLock<OptionTable<Drink>> = LazyLock::new(|| {
    OptionTable::new("mixes a drink (a demo class)")
        .exec(&[Form {
            text: "",
            floats: 0,
            takes: "",
            gives: "2 floats: tea in l, lemon as part of one",
            results: "tea: l; lemon",
            help: "mixes the drink",
        }])
        .float(
            "tea",
            0.0..=2.0,
            "l",
            "how much tea",
            |drink: &mut Drink| &mut drink.tea,
        )
        .float("lemon", 0.0..=1.0, "", "how much of a lemon", |drink| {
            &mut drink.lemon
        })
        .choice(
            "ice",
            &["none", "crushed", "cubes"],
            "form of the ice",
            |drink| &mut drink.ice,
        )
});

impl ServiceObject for Drink {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        DRINK.form(io)?;
        if self.tea == 0.0 {
            return Err(Report::error(code::NO_TEA, "there is no tea; set -tea"));
        }
        io.floats.clear();
        io.floats.extend([self.tea, self.lemon]);
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        DRINK.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        DRINK.dump(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Dictionary, Reply};
    use ctos::diagnostic::Source;

    fn kitchen() -> Sorm {
        let mut dictionary = Dictionary::new();
        dictionary.load(&Source::new("demo", DICTIONARY)).unwrap();
        let sorm = Sorm::new(dictionary);
        register(&sorm);
        sorm
    }

    fn ask(sorm: &Sorm, line: &str) -> Transport {
        sorm.dispatch(line).parse::<Reply>().unwrap().body
    }

    #[test]
    fn the_flavors_of_the_report_differ_by_their_recipes() {
        let sorm = kitchen();
        let said = |line: &str| ask(&sorm, line).text;
        assert_eq!(said("foo.a EXEC"), "breakfast in the kitchen, presto");
        assert_eq!(
            said("foo.b EXEC"),
            "breakfast in the garden, adagio, fresh juice"
        );
        assert_eq!(ask(&sorm, "bar EXEC").floats, [1.5, 0.3]);
    }

    #[test]
    fn a_slow_flavor_is_derived_while_it_runs_as_the_report_does_with_carry() {
        let sorm = kitchen();
        let added = ask(
            &sorm,
            "dict CTRL -add foo.slow '-SUBST foo -transferSpeed 0.2'",
        );
        assert!(added.is_ok());
        assert_eq!(ask(&sorm, "foo.slow EXEC FMSG 6 3 4 0 4 5 0").floats, [0.2]);
        assert_eq!(ask(&sorm, "foo EXEC FMSG 6 4 5 0 3 4 0").floats, [0.8]);
    }

    #[test]
    fn a_wrong_count_is_refused_with_the_right_one() {
        let sorm = kitchen();
        let refused = ask(&sorm, "bar EXEC FMSG 1 2");
        assert_eq!(
            refused.reports[0].text,
            "EXEC takes no floats (FMSG), not 1"
        );
    }
}
