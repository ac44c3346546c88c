//! Output that is taken away while it is written: what was written to a removed file is gone when it is closed, and one that another
//! program emptied (a log rotated by copy and truncate, `> scan.mcap`) goes on behind a hole.

use std::fs::{File, Metadata};
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// What became of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Displacement {
    path: PathBuf,
    how: How,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum How {
    /// It has no name left: all that is in it is gone when it is closed.
    Removed,
    /// It has another name, or its disk is mounted elsewhere or nowhere.
    Moved,
    /// It is there, and what was in it is not.
    Emptied,
}

/// Bytes at the beginning of a file that are never all zero in one that was written from there.
const BEGINNING: usize = 8;

/// Whether a file begins with a hole: it was cut to nothing, and then written on behind where it had ended. One that cannot be read is
/// taken to be whole.
fn begins_with_a_hole(path: &Path) -> bool {
    let mut beginning = [1; BEGINNING];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut beginning));
    read.is_ok() && beginning == [0; BEGINNING]
}

impl Displacement {
    /// Of an open file that was made at `path`; `None` where the path still leads to it and it is whole.
    pub(crate) fn of(path: &Path, open: Metadata) -> Option<Self> {
        let there = std::fs::metadata(path);
        if there.is_ok_and(|there| (there.dev(), there.ino()) == (open.dev(), open.ino())) {
            // A pipe has no beginning, and what is read from it is gone.
            let is_emptied = open.is_file() && begins_with_a_hole(path);
            return is_emptied.then(|| Self {
                path: path.to_owned(),
                how: How::Emptied,
            });
        }
        let how = match open.nlink() {
            0 => How::Removed,
            _ => How::Moved,
        };
        Some(Self {
            path: path.to_owned(),
            how,
        })
    }

    /// What counts as lost of the messages in it; `messages` as for [`Displacement::sentence`].
    pub(crate) fn lost(&self, messages: Option<u64>) -> u64 {
        match self.how {
            How::Removed | How::Emptied => messages.unwrap_or_default().max(1),
            // Nothing, but it is not where whoever looks for it will look.
            How::Moved => 1,
        }
    }

    /// For the operator; `messages`: how many are in it, `None` where it could not be closed; `next`: the file with which the recording
    /// goes on.
    pub(crate) fn sentence(&self, messages: Option<u64>, next: Option<&Path>) -> String {
        let path = self.path.display();
        let what = match (self.how, messages) {
            (How::Removed, Some(messages)) => {
                format!("{path} was deleted during recording: its {messages} messages are lost")
            }
            (How::Removed, None) => {
                format!("{path} was deleted during recording: its messages are lost")
            }
            (How::Emptied, messages) => format!(
                "{path} was truncated by another program during recording: of its {}messages only the last may be left (`lsfb recover`)",
                messages.map_or_else(String::new, |count| format!("{count} "))
            ),
            (How::Moved, Some(messages)) => format!(
                "{path} was renamed, or its disk was unmounted, during recording: its {messages} messages are in it, wherever it is now"
            ),
            (How::Moved, None) => format!(
                "{path} was renamed, or its disk was unmounted, during recording, and could not be closed: the rest of it is wherever the file is now (`lsfb recover`)"
            ),
        };
        match next {
            Some(next) => format!("{what}; the recording continues in {}", next.display()),
            None => what,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Once 8 of 31 MB were zeros, and the recording said that nothing was lost.
    #[test]
    fn a_file_that_another_program_emptied_is_noticed() {
        use std::io::Write;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        let mut open = File::create(&path).unwrap();
        let found = |open: &File| Displacement::of(&path, open.metadata().unwrap());
        assert_eq!(found(&open), None, "nothing is in it yet");
        open.write_all(b"what was recorded").unwrap();
        assert_eq!(found(&open), None);
        File::create(&path).unwrap();
        open.write_all(b"and goes on").unwrap();
        let emptied = found(&open).unwrap();
        assert_eq!((emptied.lost(Some(7)), emptied.lost(None)), (7, 1));
        let sentence = emptied.sentence(Some(7), None);
        assert!(sentence.contains("truncated") && sentence.contains("its 7 messages"));
    }

    #[test]
    fn a_file_that_is_removed_renamed_or_replaced_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        let other = folder.path().join("other.mcap");
        let open = File::create(&path).unwrap();
        let found = || Displacement::of(&path, open.metadata().unwrap());
        assert_eq!(found(), None);
        std::fs::rename(&path, &other).unwrap();
        assert_eq!(found().unwrap().lost(Some(7)), 1);
        // A file of the same name is not the same file.
        std::fs::write(&path, "").unwrap();
        assert_eq!(found().unwrap().lost(Some(7)), 1);
        std::fs::remove_file(&other).unwrap();
        let gone = found().unwrap();
        assert_eq!((gone.lost(Some(7)), gone.lost(None)), (7, 1));
        let sentence = gone.sentence(Some(7), Some(&other));
        assert!(sentence.contains("its 7 messages are lost") && sentence.contains("other.mcap"));
    }
}
