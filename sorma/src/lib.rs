//! Service objects with EXEC, CTRL and DBX, reached by one line of text
