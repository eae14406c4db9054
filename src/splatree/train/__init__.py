"""Learning from pictures: trees refined against renders of their own leaves."""
