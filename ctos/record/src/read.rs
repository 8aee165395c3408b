//! Reading records, those too that were not closed: everything up to the last chunk that is whole.
//!
//! Several files are read as one, in the order of their moments. What happened to messages stands in a file
//! as it was noted, and is turned here into the lines that everybody reads.

use std::{
    collections::{BTreeMap, VecDeque},
    fs::File,
    io::{self, BufWriter, Read, Seek, SeekFrom, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    sync::Arc,
};

use mcap::{
    WriteOptions,
    records::{MessageHeader, Record as Part},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use super::{
    counts::Counts,
    event::Traffic,
    glossary::Glossary,
    lines::{self, EVENTS},
    parts::{FORMAT, FORMAT_NOW, LOST, LineWriter, NAMES, RUN},
    summary::{Contents, Without},
    traffic::Events,
};
use ctos_core::tap::ChannelSchema;
use ctos_time::Instant;

/// The longest record of a file that is read, bytes.
pub(crate) const RECORD_LIMIT: usize = 256 * 1024 * 1024;

/// Why a record could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened, read or written.
    #[error("{path}: {error}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// It is not an MCAP file.
    #[error("{path} is no MCAP file: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with its beginning.
        reason: String,
    },
    /// Another version of the program wrote it.
    #[error(
        "{path} is a record of format {found}, and this program reads format {FORMAT_NOW}: read it with the program that wrote it, or record anew"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: String,
    },
}

/// A channel of a record.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Channel {
    /// Its name, `/message/arm` for example.
    pub topic: String,
    schema: ChannelSchema,
}

impl Channel {
    /// The name of its schema.
    #[must_use]
    pub fn schema(&self) -> &str {
        &self.schema.name
    }

    /// How its lines are written: `json`, or as a task said that recorded with a schema of its own.
    #[must_use]
    pub fn encoding(&self) -> &str {
        &self.schema.encoding
    }
}

/// One line of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// When it happened.
    pub at: Instant,
    /// Where it stands.
    pub channel: Arc<Channel>,
    /// What stands there: one JSON object, or what [`Channel::encoding`] says.
    pub json: Vec<u8>,
    /// What happened to a message, where the file has it as it was noted; `json` was made of it.
    pub(crate) event: Option<Traffic>,
}

/// What a file is the record of, and how it ends.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Run {
    /// The file.
    pub path: PathBuf,
    /// What its writer noted: `app`, `seed`, `time`, `chassis`, `part`, ...
    pub noted: BTreeMap<String, String>,
    /// Why it ends before its end; `None` when it was closed in order.
    pub torn: Option<String>,
    /// Events that its writer knows it lacks.
    pub lost: u64,
    /// Lines of each channel, and the bytes that they take in the file.
    pub channels: BTreeMap<String, (u64, u64)>,
    /// The first and the last moment.
    pub span: Option<(Instant, Instant)>,
}

impl Run {
    /// Lines in all.
    #[must_use]
    pub fn lines(&self) -> u64 {
        self.channels.values().map(|(lines, _)| lines).sum()
    }
}

/// Which lines of a record are wanted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Filter {
    /// Names of channels, in which `*` stands for any characters; none: all.
    pub topics: Vec<String>,
    /// Nothing before this moment.
    pub from: Option<Instant>,
    /// Nothing after this moment.
    pub to: Option<Instant>,
}

impl Filter {
    /// Whether a line at `at` of channel `topic` is wanted.
    #[must_use]
    pub fn takes(&self, topic: &str, at: Instant) -> bool {
        self.from.is_none_or(|from| at >= from)
            && self.to.is_none_or(|to| at <= to)
            && self.names(topic)
    }

    /// Whether lines of channel `topic` may be wanted.
    pub(crate) fn names(&self, topic: &str) -> bool {
        let mut topics = self.topics.iter();
        self.topics.is_empty() || topics.any(|pattern| matches(pattern, topic))
    }
}

/// Whether `text` is `pattern`, in which `*` stands for any characters.
pub(super) fn matches(pattern: &str, text: &str) -> bool {
    let mut parts = pattern.split('*');
    let Some(mut rest) = parts.next().and_then(|first| text.strip_prefix(first)) else {
        return false;
    };
    let Some(last) = parts.next_back() else {
        return rest.is_empty();
    };
    for part in parts {
        match rest.find(part) {
            Some(place) => rest = rest.get(place + part.len()..).unwrap_or(""),
            None => return false,
        }
    }
    rest.ends_with(last)
}

/// Several files read as one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    /// The files.
    pub runs: Vec<Run>,
    /// The lines wanted, in the order of their moments.
    pub entries: Vec<Entry>,
}

impl Record {
    /// Reads `paths`. A file that breaks off is read up to there, and says so in its [`Run`].
    ///
    /// # Errors
    /// [`ReadError`] when a file cannot be read at all.
    pub fn read(paths: &[PathBuf], filter: &Filter) -> Result<Self, ReadError> {
        let mut record = Self::default();
        for path in paths {
            let run = scan_only(path, filter, |entry| record.entries.push(entry))?;
            record.runs.push(run);
        }
        // Stable: lines of one file at one moment keep their order.
        record.entries.sort_by_key(|entry| entry.at);
        Ok(record)
    }

    /// Writes the lines as one file, which must not be there yet.
    ///
    /// # Errors
    /// [`ReadError`] when it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ReadError> {
        let mut options = File::options();
        let file = options.write(true).create_new(true).mode(0o600).open(path);
        let written = self.write_to(BufWriter::new(file.map_err(failed(path))?));
        written.map_err(|error| failed(path)(io::Error::other(error)))
    }

    fn write_to(&self, file: BufWriter<File>) -> mcap::McapResult<()> {
        let mut writer = LineWriter::new(WriteOptions::new(), file)?;
        for run in &self.runs {
            let mut noted = run.noted.clone();
            noted.insert("file".to_owned(), run.path.display().to_string());
            writer.metadata(RUN, noted)?;
        }
        writer.lost(self.runs.iter().map(|run| run.lost).sum())?;
        for entry in &self.entries {
            let (at, channel) = (entry.at.as_nanos(), &entry.channel);
            writer.line(&channel.topic, &channel.schema, at, &entry.json)?;
        }
        writer.finish()?;
        writer.mcap.into_inner().flush()?;
        Ok(())
    }
}

fn entry(at: Instant, channel: Arc<Channel>, json: Vec<u8>, event: Option<Traffic>) -> Entry {
    Entry {
        at,
        channel,
        json,
        event,
    }
}

/// What has been read of a file so far.
pub(crate) struct Scan<'a> {
    filter: &'a Filter,
    schemas: BTreeMap<u16, ChannelSchema>,
    channels: BTreeMap<u16, Arc<Channel>>,
    glossary: Glossary,
    /// The channels of what happened to messages, by their names.
    traffic: BTreeMap<String, Arc<Channel>>,
    run: Run,
    counts: Counts,
    /// The end of the file has told what is in it.
    counted: bool,
    closed: bool,
    /// The format that it has, if that is another one.
    foreign: Option<String>,
}

impl<'a> Scan<'a> {
    pub(crate) fn new(path: &Path, filter: &'a Filter) -> Self {
        Self {
            filter,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            glossary: Glossary::default(),
            traffic: BTreeMap::new(),
            run: Run {
                path: path.to_owned(),
                ..Run::default()
            },
            counts: Counts::default(),
            counted: false,
            closed: false,
            foreign: None,
        }
    }

    /// Takes what the end of the file says of all of it. Channels stand in chunks that may be passed over.
    fn expect(&mut self, contents: Contents) {
        (self.counts, self.counted) = (contents.counts, true);
        for (id, channel) in contents.summary.channels {
            let known = channel.schema.as_ref();
            if let Some(known) = known {
                self.schema(known.id, &known.name, &known.encoding, &known.data);
            }
            let schema = known.map_or(0, |known| known.id);
            self.channel(id, &channel.topic, schema, &channel.message_encoding);
        }
    }

    fn schema(&mut self, id: u16, name: &str, language: &str, text: &[u8]) {
        let schema = ChannelSchema {
            name: name.to_owned().into(),
            language: language.to_owned().into(),
            text: text.to_owned().into(),
            ..ChannelSchema::default()
        };
        self.schemas.insert(id, schema);
    }

    fn channel(&mut self, id: u16, topic: &str, schema: u16, encoding: &str) {
        let mut schema = self.schemas.get(&schema).cloned().unwrap_or_default();
        schema.encoding = encoding.to_owned().into();
        let topic = topic.to_owned();
        let channel = Channel { topic, schema };
        self.channels.insert(id, Arc::new(channel));
    }

    /// Takes one record of the file.
    fn take(&mut self, part: Part<'_>, see: &mut impl FnMut(Entry)) {
        match part {
            Part::Schema { header, data } => {
                self.schema(header.id, &header.name, &header.encoding, &data);
            }
            Part::Channel(one) => {
                self.channel(one.id, &one.topic, one.schema_id, &one.message_encoding);
            }
            Part::Message { header, data } => self.message(&header, &data, see),
            Part::Metadata(metadata) if metadata.name == NAMES => {
                let read = self.glossary.add(&metadata.metadata);
                if !read {
                    self.tear("the names in it cannot be read");
                }
            }
            Part::Metadata(metadata) if metadata.name == RUN => {
                let format = metadata.metadata.get(FORMAT).map_or("1", String::as_str);
                self.foreign = (format != FORMAT_NOW).then(|| format.to_owned());
                self.run.noted.extend(metadata.metadata);
            }
            Part::Metadata(metadata) if metadata.name == LOST => {
                let events = metadata.metadata.get("events");
                self.run.lost = events.and_then(|count| count.parse().ok()).unwrap_or(0);
            }
            Part::Footer(_) => self.closed = true,
            // What follows has been read.
            Part::DataEnd(_) if self.counted => self.closed = true,
            _ => {}
        }
    }

    /// What follows cannot be trusted.
    fn tear(&mut self, why: &str) {
        self.run.torn.get_or_insert_with(|| why.to_owned());
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8], see: &mut impl FnMut(Entry)) {
        let Some(channel) = self.channels.get(&header.channel_id).cloned() else {
            return;
        };
        if channel.schema.encoding == EVENTS {
            return self.stretch(data, see);
        }
        self.count(&channel.topic, header.log_time, data.len());
        let at = Instant::from_nanos(header.log_time);
        if self.filter.takes(&channel.topic, at) {
            see(entry(at, channel, data.to_vec(), None));
        }
    }

    fn count(&mut self, topic: &str, at: u64, bytes: usize) {
        if !self.counted {
            self.counts.add(topic, at, bytes);
        }
    }

    /// Takes what happened to messages.
    fn stretch(&mut self, bytes: &[u8], see: &mut impl FnMut(Entry)) {
        let mut events = Events::new(bytes);
        for (event, data, length) in events.by_ref() {
            let task = self.glossary.task(event.key.task);
            let (kind, schema) = lines::kind_of(&event.step);
            let topic = lines::channel_of(kind, &task);
            self.count(&topic, event.at, length);
            let at = Instant::from_nanos(event.at);
            if !self.filter.takes(&topic, at) {
                continue;
            }
            let json = match lines::traffic(&event, data, &self.glossary) {
                Ok(json) => json,
                Err(error) => return self.tear(&error.to_string()),
            };
            let new = |topic: &String| {
                let (topic, schema) = (topic.clone(), schema.text().into_owned());
                Arc::new(Channel { topic, schema })
            };
            let channel = self.traffic.entry(topic).or_insert_with_key(new);
            see(entry(at, channel.clone(), json, Some(event)));
        }
        if !events.is_at_end() {
            self.tear("what happened to messages cannot be read any further");
        }
    }
}

/// Reads one file from its beginning to where it ends or breaks off, and shows what `filter` takes; the
/// rest is counted. Of a file that was closed only what may hold something wanted is read.
///
/// # Errors
/// [`ReadError`] when it cannot be opened, or is not an MCAP file from its first byte.
pub fn scan_only(path: &Path, filter: &Filter, see: impl FnMut(Entry)) -> Result<Run, ReadError> {
    scan_in(open(path)?, path, filter, see)
}

fn failed(path: &Path) -> impl Fn(io::Error) -> ReadError {
    |error| ReadError::Io {
        path: path.to_owned(),
        error,
    }
}

fn open(path: &Path) -> Result<File, ReadError> {
    File::open(path).map_err(failed(path))
}

/// [`scan_only`] of a file that is open.
pub(crate) fn scan_in(
    mut file: impl Read + Seek,
    path: &Path,
    filter: &Filter,
    see: impl FnMut(Entry),
) -> Result<Run, ReadError> {
    let mut scan = Scan::new(path, filter);
    let mut passed = VecDeque::new();
    // What comes through a pipe has no end to look at.
    if let Ok(size) = file.seek(SeekFrom::End(0)) {
        let contents = Contents::read(&mut file, size).map_err(failed(path))?;
        let superfluous = contents.as_ref().and_then(|one| one.superfluous(filter));
        if let (Some(contents), Some(superfluous)) = (contents, superfluous) {
            scan.expect(contents);
            passed = superfluous;
        }
        file.rewind().map_err(failed(path))?;
    }
    scan.read(Without::new(file, passed), see, |_| false)
}

/// What the writer of a file noted of the run: `app`, `origin_ns`, `first`, ... Only its beginning is read.
///
/// # Errors
/// As [`scan_only`].
pub fn noted(path: &Path) -> Result<BTreeMap<String, String>, ReadError> {
    let nothing = Filter::default();
    let scan = Scan::new(path, &nothing);
    let run = scan.read(open(path)?, |_| (), |run| !run.noted.is_empty())?;
    Ok(run.noted)
}

impl Scan<'_> {
    /// Reads `file` until its end, or until there is enough.
    pub(crate) fn read(
        mut self,
        mut file: impl Read,
        mut see: impl FnMut(Entry),
        enough: impl Fn(&Run) -> bool,
    ) -> Result<Run, ReadError> {
        let path = self.run.path.clone();
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(RECORD_LIMIT);
        let mut reader = LinearReader::new_with_options(options);
        let mut begun = false;
        while let Some(event) = reader.next_event() {
            let read = match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let read = file.read(reader.insert(wanted)).map_err(failed(&path))?;
                    reader.notify_read(read);
                    Ok(())
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    begun = true;
                    mcap::parse_record(opcode, data).map(|part| self.take(part, &mut see))
                }
                Err(error) => Err(error),
            };
            if let Err(error) = read {
                self.tear(&error.to_string());
            }
            if self.closed || self.run.torn.is_some() || enough(&self.run) {
                break;
            }
            // What its writer noted of the run can be read in every format.
            if let Some(found) = self.foreign {
                return Err(ReadError::Version { path, found });
            }
        }
        if !begun {
            self.tear("it holds nothing");
            return Err(ReadError::Format {
                path,
                reason: self.run.torn.unwrap_or_default(),
            });
        }
        if !self.closed {
            self.tear("it was not closed");
        }
        self.run.span = self.counts.span();
        self.run.channels = self.counts.channels;
        Ok(self.run)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_any_letters() {
        let cases = [
            ("/log/*", "/log/arm", true),
            ("/log/*", "/message/arm", false),
            ("*arm", "/log/arm", true),
            ("*", "", true),
            ("/m*/a*m", "/message/arm", true),
            ("/m*/a*m", "/message/a", false),
            ("/log/arm", "/log/arm2", false),
            ("a*a", "a", false),
        ];
        for (pattern, text, expected) in cases {
            assert_eq!(matches(pattern, text), expected, "{pattern} {text}");
        }
    }

    #[test]
    fn a_record_of_another_format_is_refused_with_both() {
        let folder = tempfile::tempdir().unwrap();
        for format in ["1", "3"] {
            let path = folder.path().join(format);
            let mut writer = LineWriter::new(WriteOptions::new(), File::create(&path).unwrap());
            let writer = writer.as_mut().unwrap();
            // The first format did not say so.
            let said = (format != "1").then(|| (FORMAT.to_owned(), format.to_owned()));
            let noted = [("app".to_owned(), "cell".to_owned())]
                .into_iter()
                .chain(said);
            writer.metadata(RUN, noted.collect()).unwrap();
            writer.finish().unwrap();
            let error = Record::read(&[path], &Filter::default())
                .unwrap_err()
                .to_string();
            let both = [format!("format {format}"), format!("format {FORMAT_NOW}")];
            assert!(both.iter().all(|one| error.contains(one)), "{error}");
        }
    }

    #[test]
    fn rubbish_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rubbish.mcap");
        std::fs::write(&path, b"this is no record at all, only text").unwrap();
        let error = Record::read(&[path], &Filter::default()).unwrap_err();
        assert!(matches!(error, ReadError::Format { .. }), "{error}");
        assert!(error.to_string().contains("rubbish.mcap"), "{error}");
        let missing = Record::read(&[folder.path().join("none.mcap")], &Filter::default());
        assert!(matches!(missing, Err(ReadError::Io { .. })));
    }
}
