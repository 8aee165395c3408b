//! The class `stamp`: has a request met in its process and says when it came and when it was answered, by the clock
//! there. With this each request for a remote record is an exchange that tells about the clocks (SORMA technical
//! report, section 2.2.5).

use super::answer::{int, wrong};
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::raise;
use crate::report::code;
use crate::request::{Method, Request};
use crate::transport::Transport;
use std::sync::LazyLock;

/// The class has no state of its own.
#[derive(Debug, Clone, Default)]
pub(super) struct Stamp;

pub(super) static OPTIONS: LazyLock<OptionTable<Stamp>> = LazyLock::new(|| {
    OptionTable::new(
        "has a request met in its process and says when. EXEC NAME EXEC TEXT: what NAME answers, before its IMSG two more: when \
         the request came, and when it was answered (ns of this app's time here). EXEC without a text: only these two",
    )
});

impl ServiceObject for Stamp {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let came = cx.sorm().now();
        if !io.text.is_empty() {
            let request: Request = io
                .text
                .parse()
                .map_err(|error| raise!(code::SYNTAX, "{error}"))?;
            if request.method != Method::Exec {
                return Err(wrong("stamp has EXEC requests met, and no others"));
            }
            let object = cx.sorm().resolve(&request.name)?;
            let mut body = request.body;
            cx.call_by(&object, Method::Exec, &mut body, io)?;
            io.take_data(body);
        } else {
            io.empty();
        }
        let answered = cx.sorm().now();
        let stamps = [int(came.as_nanos()), int(answered.as_nanos())];
        io.ints.splice(0..0, stamps);
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
