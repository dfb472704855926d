"""Server of the page: routes, streams of events, what keeps strangers out."""
