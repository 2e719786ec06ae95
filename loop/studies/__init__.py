"""Many runs of scenarios: campaigns, and the tuning of gains."""
