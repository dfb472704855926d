"""Drawing: colours, dashes and axes that all pictures of reports share."""
