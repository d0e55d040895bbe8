"""The sections of the report: each makes Markdown of the results of one measurement."""
