//! The rules of the variants, as switches.

use crate::board::Colour;

/// Which game is played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Variant {
    /// International rules on 8x8.
    Brazilian,
    /// Shashki.
    Russian,
    /// American pool checkers.
    Pool,
    /// American checkers, British draughts.
    English,
    /// Dama.
    Italian,
    /// Damas; Portuguese rules are the same.
    Spanish,
    /// Czech draughts.
    Czech,
}

/// What a capture must have more of, the first thing first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Priority {
    /// Any capture will do.
    Free,
    /// If a king can capture, a king must.
    WithKing,
    /// Pieces.
    Most,
    /// Pieces, then kings among them.
    MostThenKings,
    /// Pieces; then with a king; then kings among them; then kings as early as can be.
    Italian,
}

/// The rules of a variant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rules {
    /// Men capture backwards too.
    pub men_back: bool,
    /// Kings move and capture at any distance.
    pub flying: bool,
    /// Men may capture kings.
    pub men_take_kings: bool,
    /// A man that reaches the last row while it captures goes on as a king.
    pub crowned_in_passing: bool,
    pub priority: Priority,
}

/// When a game is drawn though there are moves; in half-moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DrawRules {
    /// A position that occurs so often, with the same side to move, is a draw.
    pub repetitions: usize,
    /// So many moves of kings only, without capture, are a draw.
    pub quiet: u32,
    /// Three kings or more against one king have so many moves, from when that arose.
    pub three_against_one: Option<u32>,
    /// Whether an [`Ending`](crate::Ending) of few pieces is a draw, too.
    pub few_pieces: bool,
}

impl Variant {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Brazilian,
        Self::Russian,
        Self::Pool,
        Self::English,
        Self::Italian,
        Self::Spanish,
        Self::Czech,
    ];

    /// Their names, in the order of [`Variant::ALL`].
    pub const NAMES: &'static [&'static str] = &[
        "brazilian",
        "russian",
        "pool",
        "english",
        "italian",
        "spanish",
        "czech",
    ];

    /// The variant's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Brazilian => "brazilian",
            Self::Russian => "russian",
            Self::Pool => "pool",
            Self::English => "english",
            Self::Italian => "italian",
            Self::Spanish => "spanish",
            Self::Czech => "czech",
        }
    }

    /// The variant of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|variant| variant.name() == name)
    }

    /// The number of PDN's tag `GameType`.
    #[must_use]
    pub const fn game_type(self) -> u8 {
        match self {
            Self::English => 21,
            Self::Italian => 22,
            Self::Pool => 23,
            Self::Spanish => 24,
            Self::Russian => 25,
            Self::Brazilian => 26,
            Self::Czech => 29,
        }
    }

    /// The variant of PDN's tag `GameType`; 28, Portuguese, has the Spanish rules.
    #[must_use]
    pub fn of_game_type(number: u32) -> Option<Self> {
        if number == 28 {
            return Some(Self::Spanish);
        }
        Self::ALL
            .into_iter()
            .find(|variant| u32::from(variant.game_type()) == number)
    }

    /// Who moves first.
    #[must_use]
    pub const fn starts(self) -> Colour {
        match self {
            Self::English | Self::Pool => Colour::Black,
            _ => Colour::White,
        }
    }

    /// Whether the corner at White's left hand is no playing square.
    #[must_use]
    pub const fn mirrored(self) -> bool {
        matches!(self, Self::Italian | Self::Spanish)
    }

    /// When a game is drawn. Repetition is common to all; Brazilian and Russian as FMJD-64 has them (7.2.3 to 7.2.8), the others
    /// as their federations do: 40 moves in English and Italian draughts, 13 for three kings against one in pool.
    #[must_use]
    pub const fn draws(self) -> DrawRules {
        let (quiet, three_against_one) = match self {
            Self::Brazilian | Self::Russian => (30, Some(30)),
            Self::Pool => (80, Some(26)),
            Self::English | Self::Italian | Self::Spanish | Self::Czech => (80, None),
        };
        DrawRules {
            repetitions: 3,
            quiet,
            three_against_one,
            few_pieces: matches!(self, Self::Brazilian | Self::Russian),
        }
    }

    #[inline]
    pub(crate) const fn rules(self) -> Rules {
        let free = Rules {
            men_back: true,
            flying: true,
            men_take_kings: true,
            crowned_in_passing: false,
            priority: Priority::Free,
        };
        match self {
            Self::Brazilian => Rules {
                priority: Priority::Most,
                ..free
            },
            Self::Russian => Rules {
                crowned_in_passing: true,
                ..free
            },
            Self::Pool => free,
            Self::English => Rules {
                men_back: false,
                flying: false,
                ..free
            },
            Self::Italian => Rules {
                men_back: false,
                flying: false,
                men_take_kings: false,
                priority: Priority::Italian,
                ..free
            },
            Self::Spanish => Rules {
                men_back: false,
                priority: Priority::MostThenKings,
                ..free
            },
            Self::Czech => Rules {
                men_back: false,
                priority: Priority::WithKing,
                ..free
            },
        }
    }
}
