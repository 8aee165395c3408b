//! Lines of text for tasks: what a person at an inspector says to a task that takes such lines. The task is also
//! told when that person is gone. Knows no form of the text.

ctos_message::command! {
    /// Asks by one line of text.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Say {
        /// The line. The reply is one too, in the form of whoever answers.
        pub line: String,
        /// Who asks.
        pub from: String,
        /// The number by which whoever asks follows the request through all that it leads to; 0 when nobody does.
        pub trace: u64,
    } => String, 0x0002, "say"
}
ctos_message::command! {
    /// Tells that somebody who asked by text is gone and wants nothing any more.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Gone {
        /// Who, as in [`Say::from`].
        pub who: String,
    } => (), 0x0003, "gone"
}
