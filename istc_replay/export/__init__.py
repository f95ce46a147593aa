"""Outputs: the only code that writes files."""

import os

# Rerun reads this once, when it is imported: warnings, but for the one of a file without a footer.
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding::rrd::file_sink=error")
