//! The unit's side of a link, for mocks.

use std::time::Duration;

use super::wire::XuDevice;
use crate::Error;
use crate::transport::camera_socket::{CameraUnit, UnitRequest};

impl XuDevice {
    /// Answers one request of the host at `link`: the usual way to serve. A start is left to the caller and given back.
    pub fn serve(
        &mut self,
        link: &mut CameraUnit,
        timeout: Duration,
    ) -> Result<Option<UnitRequest>, Error> {
        let request = link.next_request(timeout)?;
        match &request {
            Some(UnitRequest::XuSet { selector, bytes }) => {
                link.reply_set(*selector, self.set(*selector, bytes))?;
            }
            Some(UnitRequest::XuGet { selector, query }) => {
                link.reply_get(*selector, *query, self.get(*selector, *query))?;
            }
            Some(UnitRequest::Start { .. }) | None => {}
        }
        Ok(request)
    }
}
