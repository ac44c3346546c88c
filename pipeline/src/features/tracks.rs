//! One point seen in many images: matches joined into tracks.

use super::matching::Match;

/// Matches between two images.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagePair {
    /// Index of the first image.
    pub first: usize,
    /// Index of the second image.
    pub second: usize,
    /// Their matches.
    pub matches: Vec<Match>,
}

/// A keypoint of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrackedKeypoint {
    /// Index of the image.
    pub image: u32,
    /// Index of the keypoint in it.
    pub keypoint: u32,
}

/// Keypoints believed to show one point, at most one per image, by image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Track {
    /// The keypoints.
    pub keypoints: Vec<TrackedKeypoint>,
}

/// Joins matches into tracks, most similar pairs first. A match that would put two keypoints of one image into a track
/// contradicts better ones and is dropped. Tracks in fewer than `min_images` images are left out; the rest come in
/// order of their first keypoint. `keypoint_counts` is the number of keypoints of each image; matches beyond it are
/// ignored.
pub fn build_tracks(
    keypoint_counts: &[usize],
    pairs: &[ImagePair],
    min_images: usize,
) -> Vec<Track> {
    let mut starts = vec![0usize];
    for count in keypoint_counts {
        starts.push(starts.last().copied().unwrap_or(0) + count);
    }
    let total = starts.last().copied().unwrap_or(0);
    let node = |image: usize, keypoint: u32| {
        let valid = (keypoint as usize) < *keypoint_counts.get(image)?;
        valid.then(|| starts[image] + keypoint as usize)
    };
    let mut edges: Vec<(u32, usize, usize)> = Vec::new();
    for pair in pairs {
        for m in &pair.matches {
            if let (Some(a), Some(b)) = (node(pair.first, m.first), node(pair.second, m.second)) {
                edges.push((m.distance_squared, a.min(b), a.max(b)));
            }
        }
    }
    edges.sort_unstable();

    let mut forest = Forest::new(total, &starts);
    for (_, a, b) in edges {
        forest.join_unless_contradicting(a, b);
    }
    forest.into_tracks(min_images)
}

/// Disjoint sets that know their members.
struct Forest {
    parent: Vec<u32>,
    /// Members of each root, sorted by image; empty for non-roots.
    members: Vec<Vec<TrackedKeypoint>>,
}

impl Forest {
    fn new(total: usize, starts: &[usize]) -> Self {
        let mut members = Vec::with_capacity(total);
        for (image, range) in starts.windows(2).enumerate() {
            members.extend((0..range[1] - range[0]).map(|keypoint| {
                vec![TrackedKeypoint {
                    image: image as u32,
                    keypoint: keypoint as u32,
                }]
            }));
        }
        Self {
            parent: (0..total as u32).collect(),
            members,
        }
    }

    fn root(&mut self, node: usize) -> usize {
        let mut root = node;
        while self.parent[root] as usize != root {
            let above = self.parent[root] as usize;
            self.parent[root] = self.parent[above];
            root = above;
        }
        root
    }

    fn join_unless_contradicting(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        let (into, from) = if self.members[a].len() >= self.members[b].len() {
            (a, b)
        } else {
            (b, a)
        };
        let large = &self.members[into];
        let shares_image = self.members[from]
            .iter()
            .any(|k| large.binary_search_by_key(&k.image, |l| l.image).is_ok());
        if shares_image {
            return;
        }
        let moved = std::mem::take(&mut self.members[from]);
        self.members[into].extend(moved);
        self.members[into].sort_unstable();
        self.parent[from] = into as u32;
    }

    fn into_tracks(self, min_images: usize) -> Vec<Track> {
        let long_enough = |m: &Vec<TrackedKeypoint>| m.len() >= min_images.max(1);
        let mut tracks: Vec<Track> = self
            .members
            .into_iter()
            .filter(long_enough)
            .map(|keypoints| Track { keypoints })
            .collect();
        tracks.sort_unstable_by(|a, b| a.keypoints.cmp(&b.keypoints));
        tracks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(first: usize, second: usize, matches: &[(u32, u32, u32)]) -> ImagePair {
        let matches = matches
            .iter()
            .map(|&(first, second, distance_squared)| Match {
                first,
                second,
                distance_squared,
            })
            .collect();
        ImagePair {
            first,
            second,
            matches,
        }
    }

    #[test]
    fn chains_join_and_the_worse_of_two_contradicting_matches_goes() {
        let pairs = [
            pair(0, 1, &[(0, 1, 10), (1, 0, 20)]),
            pair(1, 2, &[(1, 2, 10)]),
            // Would bring keypoint 1 of image 0 into the track of keypoint 0.
            pair(0, 2, &[(1, 2, 90)]),
            pair(0, 3, &[(7, 0, 1)]),
        ];
        let tracks = build_tracks(&[2, 2, 3, 1], &pairs, 2);
        let keypoints = |track: &Track| -> Vec<(u32, u32)> {
            track
                .keypoints
                .iter()
                .map(|k| (k.image, k.keypoint))
                .collect()
        };
        assert_eq!(tracks.len(), 2);
        assert_eq!(keypoints(&tracks[0]), [(0, 0), (1, 1), (2, 2)]);
        assert_eq!(keypoints(&tracks[1]), [(0, 1), (1, 0)]);
        assert_eq!(build_tracks(&[2, 2, 3, 1], &pairs, 3).len(), 1);
    }
}
