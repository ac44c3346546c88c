//! What a recording holds, read while what came before is worked on.

use crate::Error;

/// Items that are read while another is worked on.
const AHEAD: usize = 4;

/// Takes each item of a stream in turn, while a second thread, which opens it, reads those behind it; where none can be started, one after
/// the other. Ends at the first failure.
pub(crate) fn read_ahead<T: Send, S: Iterator<Item = T>>(
    open: impl Fn() -> Result<S, lsfb_recording::Error> + Sync,
    mut take: impl FnMut(T) -> Result<(), Error>,
) -> Result<(), Error> {
    std::thread::scope(|scope| {
        let (sender, items) = std::sync::mpsc::sync_channel(AHEAD);
        let open = &open;
        let read = move || {
            // Nobody takes more after a failure.
            let send = |item| sender.send(item).is_ok();
            match open() {
                Ok(mut stream) => stream.all(|item| send(Ok(item))),
                Err(why) => send(Err(why)),
            }
        };
        let reader = std::thread::Builder::new().name("read-ahead".to_owned());
        match reader.spawn_scoped(scope, read) {
            Ok(_) => items.into_iter().try_for_each(|item| take(item?)),
            Err(_) => open()?.try_for_each(take),
        }
    })
}
