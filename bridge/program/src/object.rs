//! The class `program`: a service object that a program is. Its flavor is the name of the task: `program.gauge EXEC read`.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use sorma::{
    Class, ClassInfo, Context, OptionTable, Outcome, ServiceObject, Sorm, Transport, Waiting,
};

use crate::task::AskObject;

/// The name of the class.
pub const CLASS: &str = "program";
const VERSION: &str = "1.0";

#[derive(Debug, Clone)]
struct Options {
    task: String,
    patience: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            task: String::new(),
            patience: 10.0,
        }
    }
}

static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("a service object that a program is, in any language")
        .word(
            "task",
            "TASK",
            "the task of the program",
            |options: &mut Options| &mut options.task,
        )
        .float(
            "patience",
            0.001..=3600.0,
            "s",
            "how long the program may take to answer",
            |options| &mut options.patience,
        )
});

/// Makes the class known to a manager.
pub fn register_class(sorm: &Sorm) {
    let class = Class::new(CLASS, VERSION, |name, _| {
        let task = name.flavor().unwrap_or_default().to_owned();
        let options = Options {
            task,
            ..Options::default()
        };
        Ok(Box::new(Object { options }))
    });
    let class = class.waits().any_flavor();
    sorm.register(class.described(TABLE.class(CLASS, VERSION)));
}

/// What a program may know about the class.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![TABLE.class(CLASS, VERSION)]
}

struct Object {
    options: Options,
}

impl ServiceObject for Object {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let request = AskObject {
                text: std::mem::take(&mut io.text),
                floats: std::mem::take(&mut io.floats),
                ints: std::mem::take(&mut io.ints),
            };
            let patience = Duration::from_secs_f64(self.options.patience);
            let answer = cx.call_task(&self.options.task, request, patience).await?;
            (io.text, io.floats, io.ints) = (answer.text, answer.floats, answer.ints);
            Ok(())
        }))
    }

    fn ctrl(&mut self, _: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}
