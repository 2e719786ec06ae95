"""Pages and pictures of runs: `page` puts together what there is to show."""
