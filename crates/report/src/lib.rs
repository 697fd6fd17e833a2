//! The run's report: report.html and report.json.
