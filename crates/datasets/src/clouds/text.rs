//! Points as text: a line a point, a word a number.

/// What the header of a file announces of its lines.
pub(super) struct Lines<'a> {
    /// Lines of the header: the first point is on the next.
    pub(super) header: usize,
    /// Points, one a line.
    pub(super) points: usize,
    /// Words of a line.
    pub(super) words: usize,
    /// Words that are read.
    pub(super) columns: &'a [usize],
}

impl Lines<'_> {
    /// The numbers as doubles, those of a line one after the other. What is behind the points is not looked at: other elements.
    pub(super) fn doubles(&self, text: &[u8]) -> Result<Vec<u8>, String> {
        let text = String::from_utf8_lossy(text);
        let lines = (self.header + 1..).zip(text.lines());
        let lines = lines.filter(|(_, line)| !line.trim().is_empty());
        let mut data = Vec::new();
        let mut found = 0;
        for (number, line) in lines.take(self.points) {
            found += 1;
            let words: Vec<&str> = line.split_whitespace().collect();
            if words.len() != self.words {
                return Err(format!(
                    "line {number}: {} words, but the header says {}",
                    words.len(),
                    self.words
                ));
            }
            for word in self.columns.iter().filter_map(|c| words.get(*c)) {
                let value = number_of(word)
                    .ok_or_else(|| format!("line {number}: {word:?} is not a number"))?;
                data.extend(value.to_le_bytes());
            }
        }
        match found == self.points {
            true => Ok(data),
            false => Err(format!(
                "{found} points, but the header says {}",
                self.points
            )),
        }
    }
}

/// A number as programs print it: where there was no return, `nan` and `inf` with what C libraries and Microsoft's add to them.
fn number_of(word: &str) -> Option<f64> {
    let parsed = word.parse().ok();
    parsed.or_else(|| {
        let plain = word.trim_start_matches(['+', '-']).to_lowercase();
        let is_nan = plain.starts_with("nan(") && plain.ends_with(')');
        (is_nan || plain.starts_with("1.#")).then_some(f64::NAN)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_as_programs_print_them() {
        for (word, expected) in [
            ("-1.5e-3", -1.5e-3),
            ("+7", 7.0),
            ("inf", f64::INFINITY),
            ("-inf", f64::NEG_INFINITY),
        ] {
            assert_eq!(number_of(word), Some(expected), "{word}");
        }
        for word in [
            "nan",
            "NaN",
            "-nan",
            "nan(ind)",
            "-nan(ind)",
            "nan(snan)",
            "1.#QNAN",
            "-1.#IND",
            "1.#INF00",
        ] {
            assert!(number_of(word).is_some_and(f64::is_nan), "{word}");
        }
        for word in ["1,5", "x", "-", "1.5m", "0x10", "--", "nanometre", "1#"] {
            assert_eq!(number_of(word), None, "{word}");
        }
    }
}
