//! Poses that other programs published.

use std::collections::BTreeSet;

use crate::error::Error;
use crate::layout::TopicSummary;
use crate::message::{self, PoseReading};
use crate::reader::Recording;

impl Recording {
    /// Topics whose messages say poses.
    pub fn pose_topics(&self) -> impl Iterator<Item = &str> {
        let topics = self.topics().iter();
        let topics = topics.filter(|t| message::holds_poses(&t.schema));
        topics.map(|t| t.topic.as_str())
    }

    /// Poses of a stream, in the order of the file: a topic, of which `nav_msgs/Path` says the whole trajectory with each message and the
    /// last one counts; or an edge of `tf2_msgs/TFMessage`, `/tf:parent.child`. `None`: of the only one there is, `/tf` last.
    pub fn poses(&self, stream: Option<&str>) -> Result<Vec<PoseReading>, Error> {
        let (topic, edge) = match stream {
            Some(stream) => match stream.split_once(':') {
                Some((topic, edge)) => (topic.to_owned(), Some(edge)),
                None => (stream.to_owned(), None),
            },
            None => (self.only_pose_topic()?, None),
        };
        let there = self.topics().iter().find(|t| t.topic == topic);
        let schema = there.ok_or_else(|| self.no_such_topic(&topic))?;
        let schema = schema.schema.as_str();
        let roles = self.sample_role(&topic, schema)?;
        let mut found = Vec::new();
        for said in self.samples(roles, |_, m| {
            message::decode_poses(schema, m.data).map(Some)
        }) {
            let said = said?;
            match message::holds_path(schema) {
                true => found = said,
                false => found.extend(said),
            }
        }
        match message::holds_edges(schema) || edge.is_some() {
            true => self.of_edge(&topic, edge, found),
            false => Ok(found),
        }
    }

    fn only_pose_topic(&self) -> Result<String, Error> {
        let of_one_body =
            |t: &TopicSummary| message::holds_poses(&t.schema) && !message::holds_edges(&t.schema);
        let edges =
            |t: &TopicSummary| message::holds_edges(&t.schema) && !t.topic.ends_with("/tf_static");
        match self.topics().iter().any(of_one_body) {
            true => self.only_topic("poses", of_one_body),
            false => self.only_topic("poses", edges),
        }
    }

    /// Leaves the poses of one edge.
    fn of_edge(
        &self,
        topic: &str,
        wanted: Option<&str>,
        mut found: Vec<PoseReading>,
    ) -> Result<Vec<PoseReading>, Error> {
        let name = |p: &PoseReading| format!("{}.{}", p.frame, p.child_frame);
        let edges: BTreeSet<String> = found.iter().map(name).collect();
        let all = || {
            let edges: Vec<String> = edges.iter().map(|e| format!("{topic}:{e}")).collect();
            edges.join(", ")
        };
        let Some(wanted) = wanted else {
            return match edges.len() {
                0 | 1 => Ok(found),
                _ => Err(Error::AmbiguousTopic {
                    path: self.path().to_owned(),
                    wanted: topic.to_owned(),
                    candidates: all(),
                }),
            };
        };
        if !edges.contains(wanted) {
            return Err(Error::NoSuchTopic {
                path: self.path().to_owned(),
                wanted: format!("{topic}:{wanted}"),
                available: all(),
            });
        }
        found.retain(|p| name(p) == wanted);
        Ok(found)
    }
}
