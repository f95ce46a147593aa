"""The one place where input and output meet the method: a module a job."""
