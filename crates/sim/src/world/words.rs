//! What is written on things.

use crate::noise::{Dice, below};

const WORDS: &[&str] = &[
    "access",
    "account",
    "after",
    "air",
    "annual",
    "archive",
    "area",
    "autumn",
    "basement",
    "before",
    "between",
    "bicycle",
    "book",
    "bridge",
    "budget",
    "building",
    "by",
    "cable",
    "canteen",
    "change",
    "chart",
    "city",
    "class",
    "clean",
    "closed",
    "coffee",
    "concert",
    "control",
    "copy",
    "course",
    "court",
    "danger",
    "delivery",
    "design",
    "desk",
    "door",
    "east",
    "electric",
    "energy",
    "engine",
    "entrance",
    "evening",
    "exit",
    "family",
    "field",
    "film",
    "fire",
    "first",
    "floor",
    "forest",
    "forum",
    "free",
    "from",
    "garden",
    "glass",
    "group",
    "guide",
    "hall",
    "harbour",
    "help",
    "history",
    "house",
    "island",
    "key",
    "kitchen",
    "laboratory",
    "lecture",
    "library",
    "lift",
    "light",
    "list",
    "machine",
    "market",
    "meeting",
    "metal",
    "model",
    "monday",
    "music",
    "network",
    "new",
    "night",
    "north",
    "notice",
    "of",
    "office",
    "open",
    "order",
    "paper",
    "parking",
    "people",
    "physics",
    "plan",
    "please",
    "power",
    "press",
    "project",
    "public",
    "quiet",
    "radio",
    "report",
    "research",
    "river",
    "road",
    "room",
    "safety",
    "sale",
    "school",
    "science",
    "second",
    "service",
    "signal",
    "silver",
    "south",
    "spring",
    "stairs",
    "station",
    "storage",
    "street",
    "studio",
    "summer",
    "system",
    "table",
    "team",
    "the",
    "theatre",
    "ticket",
    "tools",
    "tower",
    "train",
    "travel",
    "turn",
    "under",
    "union",
    "valley",
    "visit",
    "visitors",
    "water",
    "west",
    "window",
    "winter",
    "with",
    "workshop",
    "world",
    "year",
    "yellow",
    "zone",
];

const BEGINNINGS: &[&str] = &[
    "Al", "Ber", "Cor", "Dan", "El", "Far", "Gra", "Hol", "Ir", "Jan", "Kel", "Lin", "Mar", "Nor",
    "Os", "Pet", "Ros", "Sal", "Tor", "Ul", "Ver", "Wil", "Yar", "Zel",
];
const ENDS: &[&str] = &[
    "ana", "bach", "berg", "den", "dorf", "ell", "en", "ford", "ham", "ik", "ine", "ko", "land",
    "ley", "man", "mer", "ner", "ova", "rich", "sen", "son", "ster", "ton", "vic",
];

fn one_of(list: &[&'static str], rng: &Dice) -> &'static str {
    list[below(rng, list.len())]
}

/// A word as it stands in the middle of a sentence; now and then a number.
pub(crate) fn word(rng: &Dice) -> String {
    match below(rng, 12) {
        0 => below(rng, 2000).to_string(),
        1 => name(rng),
        _ => one_of(WORDS, rng).to_owned(),
    }
}

/// The name of a person, a place or a make.
pub(crate) fn name(rng: &Dice) -> String {
    format!("{}{}", one_of(BEGINNINGS, rng), one_of(ENDS, rng))
}

/// So many words as a title has them: with capitals first, or all of them.
pub(crate) fn title(rng: &Dice, words: usize) -> String {
    let loud = below(rng, 2) == 0;
    let list: Vec<String> = (0..words.max(1))
        .map(|_| {
            let word = word(rng);
            if loud {
                return word.to_uppercase();
            }
            let mut letters = word.chars();
            letters.next().map_or_else(String::new, |first| {
                first.to_uppercase().chain(letters).collect()
            })
        })
        .collect();
    list.join(" ")
}

/// The number of a room.
pub(crate) fn room(rng: &Dice) -> String {
    let wing = char::from(b'A' + below(rng, 6) as u8);
    format!("{wing} {}.{:03}", below(rng, 6), below(rng, 400))
}
