//! Which column of a table holds what.

use std::str::FromStr;

use lsfb_types::StampUnit;

/// Where stamp, position and rotation stand in a row, counted from zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Columns {
    /// The stamp.
    pub time: usize,
    /// x, y, z.
    pub position: [usize; 3],
    /// x, y, z, w of the quaternion; `None` where the file has positions only.
    pub rotation_xyzw: Option<[usize; 4]>,
}

/// What a row of names says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub columns: Columns,
    /// Names in the row.
    pub count: usize,
    /// Unit of the stamps, where the name says it.
    pub unit: Option<StampUnit>,
    /// Unit of the positions, where the names say another one than metres.
    pub foreign_length: Option<&'static str>,
    /// Where the row says how well its frame matched a map.
    pub frames: Option<FrameColumns>,
}

/// Which columns say how well a frame matched a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FrameColumns {
    /// Matches that fit the pose.
    pub matches: usize,
    /// 0 where the program does not vouch for the pose that it writes.
    pub localized: Option<usize>,
}

impl Columns {
    /// `t x y z qx qy qz qw`, as TUM has it.
    pub(super) const TUM: Self = Self {
        time: 0,
        position: [1, 2, 3],
        rotation_xyzw: Some([4, 5, 6, 7]),
    };
    /// `t x y z qw qx qy qz`, as EuRoC has it.
    pub(super) const EUROC: Self = Self {
        time: 0,
        position: [1, 2, 3],
        rotation_xyzw: Some([5, 6, 7, 4]),
    };
    /// `t x y z`.
    pub(super) const POSITIONS: Self = Self {
        time: 0,
        position: [1, 2, 3],
        rotation_xyzw: None,
    };
}

impl FromStr for Columns {
    type Err = String;

    /// Names in the order of the file, with `-` for what is not needed: `t,x,y,z,qw,qx,qy,qz`.
    fn from_str(text: &str) -> Result<Self, String> {
        let header = Header::of(text, ',');
        let header = header.ok_or("expected names such as t,x,y,z,qx,qy,qz,qw")?;
        Ok(header.columns)
    }
}

impl Header {
    /// `None` where the row does not name a stamp and a position.
    pub(super) fn of(row: &str, separator: char) -> Option<Self> {
        let row = row.trim_start_matches(['#', '%', ' ']);
        let names: Vec<Name> = match separator {
            ' ' => row.split_ascii_whitespace().map(Name::of).collect(),
            separator => row.split(separator).map(Name::of).collect(),
        };
        let find = |wanted: Meaning| names.iter().position(|name| name.meaning == Some(wanted));
        let of_header = names.iter().position(|name| name.is_header_stamp);
        let localized = find(Meaning::Localized);
        // Elsewhere the number of a frame is no stamp.
        let frame = || localized.and_then(|_| find(Meaning::Frame));
        let time = of_header.or_else(|| find(Meaning::Time)).or_else(frame)?;
        let all = |kind: fn(char) -> Meaning, letters: &[char]| -> Option<Vec<usize>> {
            letters.iter().map(|letter| find(kind(*letter))).collect()
        };
        let position: [usize; 3] = all(Meaning::Position, &['x', 'y', 'z'])?.try_into().ok()?;
        let rotation = all(Meaning::Rotation, &['x', 'y', 'z', 'w']);
        Some(Self {
            columns: Columns {
                time,
                position,
                rotation_xyzw: rotation.and_then(|columns| columns.try_into().ok()),
            },
            count: names.len(),
            unit: names.get(time)?.unit,
            foreign_length: position.iter().find_map(|i| names.get(*i)?.foreign_length),
            frames: find(Meaning::Matches).map(|matches| FrameColumns { matches, localized }),
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meaning {
    Time,
    Position(char),
    Rotation(char),
    Frame,
    Matches,
    Localized,
}

struct Name {
    meaning: Option<Meaning>,
    is_header_stamp: bool,
    unit: Option<StampUnit>,
    foreign_length: Option<&'static str>,
}

/// Units of length that tables are written in and that are no metres.
const FOREIGN_LENGTHS: [&str; 7] = ["mm", "cm", "dm", "km", "ft", "feet", "inch"];

impl Name {
    fn of(text: &str) -> Self {
        let lower = text.trim().trim_matches('"').to_lowercase();
        let (name, unit) = match lower.split_once(['[', '(']) {
            Some((name, unit)) => (name.trim(), unit.trim_end_matches([']', ')'])),
            None => (lower.as_str(), ""),
        };
        let parts: Vec<&str> = name.split(['_', '.', ' ']).collect();
        let is_time = |part: &&str| ["t", "time", "timestamp", "stamp", "times"].contains(part);
        let is_header_stamp = name.ends_with("header.stamp");
        if parts.first().is_some_and(is_time) && parts.len() <= 2 || is_header_stamp {
            let suffix = parts.get(1).copied().filter(|_| !is_header_stamp);
            // `t_x` is a position.
            if !matches!(suffix, Some("x" | "y" | "z")) {
                let unit = [Some(unit), suffix].into_iter().flatten();
                return Self {
                    meaning: Some(Meaning::Time),
                    is_header_stamp,
                    unit: unit.filter_map(|u| u.parse().ok()).next(),
                    foreign_length: None,
                };
            }
        }
        let of_frame = match name {
            "frame" => Some(Meaning::Frame),
            "localized" => Some(Meaning::Localized),
            "inliers" | "num_inliers" | "n_inliers" => Some(Meaning::Matches),
            "matches" | "num_matches" | "n_matches" => Some(Meaning::Matches),
            _ => None,
        };
        Self {
            meaning: of_frame.or_else(|| component(name)),
            is_header_stamp: false,
            unit: None,
            foreign_length: FOREIGN_LENGTHS.into_iter().find(|known| *known == unit),
        }
    }
}

/// `p_RS_R_x`, `tx`, `pos_x_m`, `pose.position.x`, `q_RS_w`, `qw`; velocities, biases and the like are none.
fn component(name: &str) -> Option<Meaning> {
    let name = name.strip_suffix("_m").unwrap_or(name);
    let letter = name.chars().last().filter(|c| "xyzw".contains(*c))?;
    let stem = name.strip_suffix(letter)?.trim_end_matches(['_', '.', ' ']);
    let has = |wanted: &[&str]| {
        stem.split(['_', '.', ' '])
            .any(|part| wanted.contains(&part))
    };
    let other = [
        "v",
        "vel",
        "velocity",
        "twist",
        "b",
        "bias",
        "a",
        "acc",
        "gyro",
        "w",
        "omega",
        "angular",
        "linear",
        "covariance",
        "cov",
        "std",
        "sigma",
    ];
    if has(&other) {
        return None;
    }
    if has(&[
        "q",
        "quat",
        "quaternion",
        "orientation",
        "ori",
        "rot",
        "rotation",
    ]) {
        return Some(Meaning::Rotation(letter));
    }
    let is_position =
        stem.is_empty() || has(&["p", "t", "pos", "position", "trans", "translation"]);
    (is_position && letter != 'w').then_some(Meaning::Position(letter))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_many_programs() {
        let of = |row: &str| Header::of(row, if row.contains(',') { ',' } else { ' ' });
        let euroc = of(
            "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], \
             v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1]",
        );
        let euroc = euroc.expect("EuRoC");
        assert_eq!((euroc.columns, euroc.count), (Columns::EUROC, 12));
        let tumvi = of(
            "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []",
        );
        assert_eq!(
            tumvi.map(|h| (h.columns, h.unit)),
            Some((Columns::EUROC, Some(StampUnit::Nanoseconds)))
        );
        for tum in [
            "# timestamp tx ty tz qx qy qz qw",
            "# timestamp_s tx_m ty_m tz_m qx qy qz qw",
            "time,x,y,z,qx,qy,qz,qw",
            "t,pos_x,pos_y,pos_z,quat_x,quat_y,quat_z,quat_w",
        ] {
            assert_eq!(of(tum).map(|h| h.columns), Some(Columns::TUM), "{tum}");
        }
        let ros = of(
            "%time,field.header.seq,field.header.stamp,field.pose.pose.position.x,field.pose.pose.position.y,\
             field.pose.pose.position.z,field.pose.pose.orientation.x,field.pose.pose.orientation.y,\
             field.pose.pose.orientation.z,field.pose.pose.orientation.w,field.pose.covariance0,field.twist.twist.linear.x",
        );
        assert_eq!(
            ros.map(|h| h.columns),
            Some(Columns {
                time: 2,
                position: [3, 4, 5],
                rotation_xyzw: Some([6, 7, 8, 9])
            })
        );
        assert_eq!(
            of("stamp,t_x,t_y,t_z,roll,pitch,yaw").map(|h| h.columns),
            Some(Columns::POSITIONS)
        );
        for none in ["# created by a program", "a,b,c", "time,v_x,v_y,v_z", ""] {
            assert_eq!(of(none), None, "{none}");
        }
    }

    #[test]
    fn columns_are_given_by_name() {
        assert_eq!("t,x,y,z,qw,qx,qy,qz".parse(), Ok(Columns::EUROC));
        assert_eq!(
            "t,-,x,y,z".parse::<Columns>().map(|c| c.position),
            Ok([2, 3, 4])
        );
        assert!("x,y,z".parse::<Columns>().is_err());
    }
}
