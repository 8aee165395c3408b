//! The class `shmem_w`: writes records into a snapshot buffer.

use super::answer::{int, wrong};
use super::host::{Host, buffer, buffer_error};
use crate::description::Form;
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::report::Report;
use crate::transport::Transport;
use sorma_snapshot::{Layout, MOST_BYTES, MOST_FLOATS, MOST_SLOTS, SnapshotError, Writer};
use std::sync::LazyLock;

#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Settings {
    name: String,
    slots: i64,
    floats: i64,
    bytes: i64,
    description: String,
    keep: bool,
    open: bool,
}

pub(super) static OPTIONS: LazyLock<OptionTable<Settings>> = LazyLock::new(|| {
    OptionTable::new(
        "writes records into a snapshot buffer. EXEC FMSG: the floats of a record, opaque or TMSG: its \
         bytes; answers IMSG 1: the number of the record",
    )
    .exec(&[
        Form {
            text: "",
            floats: Form::ANY,
            takes: "the floats of a record",
            gives: "IMSG 1: the number of the record",
            results: "",
            help: "writes a record",
        },
        Form {
            text: "TEXT",
            floats: Form::ANY,
            takes: "the floats of a record",
            gives: "IMSG 1: the number of the record",
            results: "",
            help: "writes a record with bytes",
        },
    ])
    .word(
        "name",
        "BUFFER",
        "name of the buffer; the flavor when empty",
        |set: &mut Settings| &mut set.name,
    )
    .int(
        "slots",
        0..=MOST_SLOTS as i64,
        "",
        "records that the buffer keeps; 0: 16",
        |set| &mut set.slots,
    )
    .int(
        "floats",
        0..=MOST_FLOATS as i64,
        "",
        "floats of a record",
        |set| &mut set.floats,
    )
    .int(
        "bytes",
        0..=MOST_BYTES as i64,
        "bytes",
        "the most opaque bytes of a record",
        |set| &mut set.bytes,
    )
    .word(
        "description",
        "TEXT",
        "names and units of the floats, a line for each",
        |set| &mut set.description,
    )
    .flag(
        "keep",
        "leaves the buffer to be read when its writer has ended",
        |set| &mut set.keep,
    )
    .flag(
        "open",
        "makes the buffer now and not with the first record",
        |set| &mut set.open,
    )
});

/// Slots of a buffer for which none are said.
const SLOTS: usize = 16;

pub(super) struct ShmemW {
    host: Host,
    flavor: String,
    settings: Settings,
    writer: Option<Writer>,
}

impl ShmemW {
    pub(super) fn new(host: Host, flavor: String) -> Self {
        Self {
            host,
            flavor,
            settings: Settings::default(),
            writer: None,
        }
    }

    fn name<'a>(&'a self, settings: &'a Settings) -> &'a str {
        buffer(&settings.name, &self.flavor)
    }

    fn make(&self, settings: &Settings) -> Result<Writer, Report> {
        let place = self.host.place().map_err(|error| buffer_error(&error))?;
        let layout = layout(settings);
        let mut writer = Writer::create(&place, self.name(settings), layout, &self.host.clock)
            .map_err(|error| buffer_error(&error))?;
        writer.keep(settings.keep);
        Ok(writer)
    }

    /// Takes settings that are in order; the buffer is made anew when its structure or name changed.
    fn take(&mut self, next: Settings) -> Result<(), Report> {
        let same = layout(&next) == layout(&self.settings)
            && self.name(&next) == self.name(&self.settings);
        if let Some(writer) = &mut self.writer
            && same
        {
            writer.keep(next.keep);
        } else if self.writer.is_some() || next.open {
            // Checks what it can before it gives the old buffer up.
            layout(&next)
                .check()
                .map_err(|error| buffer_error(&error))?;
            let was_open = self.writer.take().is_some();
            match self.make(&next) {
                Ok(writer) => self.writer = Some(writer),
                Err(report) => {
                    if was_open {
                        self.writer = self.make(&self.settings).ok();
                    }
                    return Err(report);
                }
            }
        }
        self.settings = next;
        Ok(())
    }
}

fn layout(settings: &Settings) -> Layout {
    let size = |number: i64| usize::try_from(number).unwrap_or(0);
    let slots = match size(settings.slots) {
        0 => SLOTS,
        slots => slots,
    };
    Layout::new(slots, size(settings.floats))
        .bytes(size(settings.bytes))
        .described(settings.description.clone())
}

impl ServiceObject for ShmemW {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        if self.writer.is_none() {
            self.writer = Some(self.make(&self.settings)?);
        }
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let bytes = if io.opaque.is_empty() {
            io.text.as_bytes()
        } else {
            &io.opaque
        };
        let count = match writer.write(&io.floats, bytes) {
            Ok(count) => count,
            Err(error @ SnapshotError::Record { .. }) => {
                return Err(wrong(error.to_string()));
            }
            Err(error) => return Err(buffer_error(&error)),
        };
        io.empty();
        io.ints.push(int(count));
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut next = self.settings.clone();
        OPTIONS.ctrl(&mut next, io);
        if !io.is_ok() || next == self.settings {
            return Ok(());
        }
        self.take(next)
    }

    fn dump(&self) -> String {
        OPTIONS.dump(&self.settings)
    }
}
