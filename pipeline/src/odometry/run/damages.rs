//! Messages that cannot be read cost themselves alone.

/// Damaged messages named in the report; the rest are counted.
const NAMED_DAMAGES: u64 = 5;

/// Parts of a recording that could not be read: reported, not fatal.
#[derive(Default)]
pub(crate) struct Damages {
    count: u64,
    first: Vec<String>,
}

impl Damages {
    /// The item, or `None` after noting why there is none.
    pub(crate) fn keep<T>(&mut self, item: Result<T, lsfb_recording::Error>) -> Option<T> {
        item.map_err(|error| {
            self.count += 1;
            if self.count <= NAMED_DAMAGES {
                self.first.push(error.to_string());
            }
        })
        .ok()
    }

    /// What was noted: the first few by name, and how many more.
    pub(crate) fn into_sentences(self) -> Vec<String> {
        let mut sentences = self.first;
        if self.count > NAMED_DAMAGES {
            let more = self.count - NAMED_DAMAGES;
            sentences.push(format!("{more} more messages could not be read"));
        }
        sentences
    }
}
