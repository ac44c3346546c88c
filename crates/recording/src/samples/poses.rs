//! Poses that other programs published.

use crate::error::Error;
use crate::message::{self, PoseReading};
use crate::reader::Recording;

impl Recording {
    /// Topics whose messages say one pose each.
    pub fn pose_topics(&self) -> impl Iterator<Item = &str> {
        let topics = self.topics().iter();
        let topics = topics.filter(|t| message::holds_pose(&t.schema));
        topics.map(|t| t.topic.as_str())
    }

    /// Poses of a topic, in the order of the file. `None`: of the only one there is.
    pub fn poses(
        &self,
        topic: Option<&str>,
    ) -> Result<impl Iterator<Item = Result<PoseReading, Error>> + use<'_>, Error> {
        let topic = match topic {
            Some(topic) => topic.to_owned(),
            None => self.only_topic("poses", |t| message::holds_pose(&t.schema))?,
        };
        let there = self.topics().iter().find(|t| t.topic == topic);
        let schema = there.ok_or_else(|| self.no_such_topic(&topic))?;
        let schema = schema.schema.clone();
        let roles = self.sample_role(&topic, &schema)?;
        Ok(self.samples(roles, move |_, message| {
            message::decode_pose(&schema, message.data).map(Some)
        }))
    }
}
