//! The class `event`: an EXEC notifies all that subscribe to it.

use crate::description::Form;
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::transport::Transport;
use std::sync::LazyLock;

#[derive(Debug, Clone, Default)]
pub(super) struct Event;

pub(super) static OPTIONS: LazyLock<OptionTable<Event>> = LazyLock::new(|| {
    OptionTable::new(
        "notifies. EXEC with any data: all who subscribe to the object get the data (in code with `Sorm::subscribe`, \
         in text with a `stream`); it answers the same data. A flavor of one's own, with an empty recipe, is an event \
         of one's own",
    )
    .exec(&[
        Form {
            text: "",
            floats: Form::ANY,
            takes: "whatever the event tells",
            gives: "the same",
            results: "",
            help: "tells all who subscribe",
        },
        Form {
            text: "TEXT",
            floats: Form::ANY,
            takes: "whatever the event tells",
            gives: "the same",
            results: "",
            help: "tells all who subscribe",
        },
    ])
});

impl ServiceObject for Event {
    fn exec(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        // What an EXEC answers goes to all who subscribe: here that is what it was given.
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}
