"""Learning from pictures: scenes from photographs, and trees refined against renders of their own leaves."""
