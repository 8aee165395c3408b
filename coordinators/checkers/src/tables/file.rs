//! Tables in files: a head with version, variant and size, a checksum, and the values.

use std::{
    fs,
    io::{self, Read},
    path::{Path, PathBuf},
};

use super::{MOST_PIECES, Tables, index::Index};
use crate::rules::Variant;

const MAGIC: [u8; 8] = *b"CTOSDAME";

/// Tables of another version are refused.
const VERSION: u32 = 1;

const HEAD: usize = 28;

/// Why tables cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file cannot be read.
    #[error("cannot read `{path}`: {error}; `tables DIR` makes it")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write `{path}`: {error}")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// The file is not as it should be.
    #[error("`{path}` is refused: {reason}; `tables DIR` makes it anew")]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// The name of a variant's file in a folder of tables.
#[must_use]
pub fn file_name(variant: Variant) -> String {
    format!("{}.tables", variant.name())
}

impl Tables {
    /// Writes the tables into a folder, which is made if it is not there; answers the file.
    ///
    /// # Errors
    /// The file, and why it cannot be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf, TableError> {
        let path = folder.join(file_name(self.variant));
        let wrong = |error| TableError::Write {
            path: path.clone(),
            error,
        };
        fs::create_dir_all(folder).map_err(wrong)?;
        // Nobody reads half a file: it gets its name when it is whole.
        let begun = path.with_extension(format!("{}.part", std::process::id()));
        fs::write(&begun, self.bytes()).map_err(wrong)?;
        fs::rename(&begun, &path).map_err(wrong)?;
        Ok(path)
    }

    /// Reads a variant's tables from a folder.
    ///
    /// # Errors
    /// The file, and what is wrong with it.
    pub fn read(folder: &Path, variant: Variant) -> Result<Self, TableError> {
        let path = folder.join(file_name(variant));
        let wrong = |error| TableError::Read {
            path: path.clone(),
            error,
        };
        let file = fs::File::open(&path).map_err(wrong)?;
        let longest = HEAD + Index::new(MOST_PIECES).len();
        let mut bytes = Vec::new();
        file.take(longest as u64 + 1)
            .read_to_end(&mut bytes)
            .map_err(wrong)?;
        Self::parse(&bytes, variant).map_err(|reason| TableError::Wrong { path, reason })
    }

    /// The tables as a file has them.
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let head = [
            VERSION,
            u32::from(self.variant.game_type()),
            self.index.pieces(),
            u32::try_from(self.values.len()).unwrap_or(u32::MAX),
        ];
        for number in head {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        let sum = checksum(&bytes, &self.values);
        bytes.extend_from_slice(&sum.to_le_bytes());
        bytes.extend_from_slice(&self.values);
        bytes
    }

    /// Reads what [`Tables::bytes`] wrote.
    ///
    /// # Errors
    /// What is wrong.
    pub fn parse(bytes: &[u8], variant: Variant) -> Result<Self, String> {
        let number = |at: usize| {
            let four = bytes.get(at..at + 4)?;
            Some(u32::from_le_bytes(four.try_into().ok()?))
        };
        if bytes.get(..8) != Some(&MAGIC) {
            return Err("it is no file of endgame tables".to_owned());
        }
        let (Some(version), Some(game), Some(pieces), Some(len), Some(sum), Some(values)) = (
            number(8),
            number(12),
            number(16),
            number(20),
            number(24),
            bytes.get(HEAD..),
        ) else {
            return Err("it ends within its head".to_owned());
        };
        if version != VERSION {
            return Err(format!("its version is {version}, and {VERSION} is read"));
        }
        if game != u32::from(variant.game_type()) {
            let of = Variant::of_game_type(game).map_or("an unknown", Variant::name);
            return Err(format!("it is of {of} draughts, not of {}", variant.name()));
        }
        if !(2..=MOST_PIECES).contains(&pieces) {
            return Err(format!(
                "it is of {pieces} pieces, and 2 to {MOST_PIECES} are read"
            ));
        }
        let index = Index::new(pieces);
        if index.len() != len as usize || values.len() != index.len() {
            let (has, should) = (values.len(), index.len());
            return Err(format!(
                "it has {has} values, and {pieces} pieces have {should}"
            ));
        }
        let head = bytes.get(..HEAD - 4).unwrap_or_default();
        if checksum(head, values) != sum {
            return Err("its checksum is wrong: it was changed or damaged".to_owned());
        }
        Ok(Self {
            variant,
            index,
            values: values.to_vec(),
        })
    }
}

fn checksum(head: &[u8], values: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(head);
    hasher.update(values);
    hasher.finalize()
}
