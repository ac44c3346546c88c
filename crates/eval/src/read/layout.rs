//! How the rows of a file are laid out.

use lsfb_types::StampUnit;

use super::colmap;
use super::columns::{Columns, FrameColumns, Header};
use super::stamp_unit::StampSize;
use super::text::{Line, shown};

/// `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`.
const COLMAP_COLUMNS: usize = 10;

/// Whether comments are those of COLMAP's `images.txt`.
fn is_colmap(comments: &[Line<'_>]) -> bool {
    comments.iter().any(|c| c.text.contains(colmap::HEAD))
}

/// Leaves the rows that say a pose: in COLMAP's file every other row lists points, three numbers each. A row that is neither (the name
/// of an image has a blank) stays, to be refused.
pub(super) fn keep_poses(rows: &mut Vec<Line<'_>>, comments: &[Line<'_>]) {
    if is_colmap(comments) {
        rows.retain(|row| {
            let columns: Vec<&str> = row.text.split_ascii_whitespace().collect();
            !columns.len().is_multiple_of(3) || columns.iter().any(|c| c.parse::<f64>().is_err())
        });
    }
}

/// What stands between columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Blank,
    Char(char),
}

impl Separator {
    pub(super) fn of(row: &str) -> Self {
        match [',', ';'].into_iter().find(|c| row.contains(*c)) {
            Some(found) => Self::Char(found),
            None => Self::Blank,
        }
    }

    /// Columns of a row; one that is empty behind the last separator is none.
    pub(super) fn split(self, row: &str) -> Vec<&str> {
        let mut columns = Vec::new();
        self.split_into(row, &mut columns);
        columns
    }

    /// The same into what was used for another row.
    pub(super) fn split_into<'a>(self, row: &'a str, columns: &mut Vec<&'a str>) {
        columns.clear();
        match self {
            Self::Blank => columns.extend(row.split_ascii_whitespace()),
            Self::Char(c) => {
                let row = row.strip_suffix(c).unwrap_or(row);
                let mut is_quoted = false;
                let ends = |letter: char| {
                    is_quoted ^= letter == '"';
                    letter == c && !is_quoted
                };
                columns.extend(row.split(ends).map(str::trim));
            }
        }
    }

    fn as_char(self) -> char {
        match self {
            Self::Blank => ' ',
            Self::Char(c) => c,
        }
    }
}

/// What a row holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Content {
    /// Stamp, position and, where known, a quaternion.
    Columns(Columns),
    /// The same in TUM's order, and the covariance.
    WithCovariance,
    /// A pose matrix row by row, three or four rows, without a stamp.
    Matrix,
    /// kapture: stamp, device, and the pose of the world in the device.
    Kapture,
    /// COLMAP's `images.txt`: the pose of the world in the camera, and a file whose name ends with the stamp.
    Colmap,
}

/// How all rows of a file are laid out.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub separator: Separator,
    pub content: Content,
    /// Columns of each row.
    pub columns: usize,
    /// Unit of the stamps, where the file says it.
    pub unit: Option<StampUnit>,
    /// Where rows say how well their frame matched a map.
    pub frames: Option<FrameColumns>,
    /// Rows of names at the top of the data.
    pub header_rows: usize,
    /// What was assumed and not said by the file.
    pub assumed: Option<&'static str>,
}

impl Layout {
    /// The layout that comments, a row of names or the rows themselves tell, in this order; what they do not tell is the problem
    /// with the first row.
    pub(super) fn of(
        rows: &[Line<'_>],
        comments: &[Line<'_>],
        given: Option<Columns>,
    ) -> Result<Self, (usize, String)> {
        let Some(first) = rows.first() else {
            return Err((0, String::new()));
        };
        if is_colmap(comments) {
            return Ok(Self {
                separator: Separator::Blank,
                content: Content::Colmap,
                columns: COLMAP_COLUMNS,
                unit: None,
                frames: None,
                header_rows: 0,
                assumed: None,
            });
        }
        let separator = Separator::of(first.text);
        let names = separator.split(first.text);
        let begins_with_a_number = names.first().is_some_and(|n| n.parse::<f64>().is_ok());
        let is_name =
            |name: &&str| name.chars().any(char::is_alphabetic) && name.parse::<f64>().is_err();
        let has_names = !begins_with_a_number && names.iter().filter(|n| is_name(n)).count() >= 4;
        let data = rows.get(usize::from(has_names)).unwrap_or(first);
        let columns = separator.split(data.text);
        let header = match has_names {
            true => Header::of(first.text, separator.as_char()),
            false => {
                let candidates = comments.iter().filter(|c| c.number < data.number);
                // EuRoC's names have commas between them also where a program has written its rows with blanks.
                let mut headers = candidates.filter_map(|c| {
                    let own = Header::of(c.text, separator.as_char());
                    let other = || Header::of(c.text, Separator::of(c.text).as_char());
                    // A comment that names other columns than there are speaks of something else.
                    let is_of_rows = |h: &Header| h.count == columns.len();
                    own.filter(is_of_rows)
                        .or_else(|| other().filter(is_of_rows))
                });
                headers.next_back()
            }
        };
        if has_names && header.is_none() && given.is_none() {
            let names = shown(first.text);
            return Err((
                first.number,
                format!("'{names}' has no stamp or no position; give the columns"),
            ));
        }
        if let (Some(unit), None) = (header.and_then(|h| h.foreign_length), given) {
            let what =
                format!("positions are in {unit} according to their names; write them in metres");
            return Err((data.number, what));
        }
        // Behind a row of names a word in the second column is somebody else's.
        let is_device = |column: &&&str| column.parse::<f64>().is_err();
        let is_kapture = comments.iter().any(|c| c.text.contains("kapture format"))
            || header.is_none() && columns.len() == 9 && columns.get(1).filter(is_device).is_some();
        let mut assumed = None;
        let content = match (given, header) {
            (Some(given), _) => Content::Columns(given),
            _ if is_kapture => Content::Kapture,
            (None, Some(header)) => Content::Columns(header.columns),
            (None, None) => {
                let found = by_count(separator, &columns, rows);
                let (content, what) = found.map_err(|what| (data.number, what))?;
                assumed = what;
                content
            }
        };
        Ok(Self {
            separator,
            content,
            columns: columns.len(),
            unit: header.and_then(|h| h.unit),
            frames: header.and_then(|h| h.frames),
            header_rows: usize::from(has_names),
            assumed,
        })
    }
}

/// The content that the number of columns tells; with commas EuRoC and TUM differ by their stamps alone.
fn by_count(
    separator: Separator,
    columns: &[&str],
    rows: &[Line<'_>],
) -> Result<(Content, Option<&'static str>), String> {
    let count = columns.len();
    let sure = |content| Ok((content, None));
    match count {
        4 => return sure(Content::Columns(Columns::POSITIONS)),
        44 => return sure(Content::WithCovariance),
        12 | 16 if separator == Separator::Blank || begins_with_a_matrix(columns) => {
            return sure(Content::Matrix);
        }
        8 if separator == Separator::Blank => return sure(Content::Columns(Columns::TUM)),
        n if n < 8 || separator == Separator::Blank => {
            return Err(format!(
                "{n} columns; expected 8 (TUM), 4 (positions), 12 (KITTI) or 8 and more with commas (EuRoC)"
            ));
        }
        _ => {}
    }
    let stamps: Vec<&str> = rows
        .iter()
        .filter_map(|row| separator.split(row.text).first().copied())
        .collect();
    let sizes: Vec<f64> = stamps.iter().filter_map(|s| s.parse().ok()).collect();
    let is_whole = stamps.iter().all(|s| !s.contains('.'));
    let is_seconds = StampSize::of(&sizes).unit() == Ok(StampUnit::Seconds);
    match (is_seconds, count) {
        (false, _) => sure(Content::Columns(Columns::EUROC)),
        (true, 8) => Ok((
            Content::Columns(Columns::TUM),
            Some(
                "no header row: columns are assumed to be t, x, y, z, qx, qy, qz, qw because stamps are in seconds",
            ),
        )),
        (true, _) if is_whole && rows.len() == 1 => sure(Content::Columns(Columns::EUROC)),
        (true, n) => Err(format!(
            "{n} columns with stamps in seconds and no header row: give the columns"
        )),
    }
}

/// A rotation's row is of length one; a stamp and a position are not.
fn begins_with_a_matrix(columns: &[&str]) -> bool {
    let row: Vec<f64> = columns
        .iter()
        .take(3)
        .filter_map(|c| c.parse().ok())
        .collect();
    row.len() == 3 && (row.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-3
}

impl Content {
    /// Whether a row says how the body is turned.
    pub(super) fn has_rotation(self) -> bool {
        !matches!(
            self,
            Self::Columns(Columns {
                rotation_xyzw: None,
                ..
            })
        )
    }
}
