"""What is known of the pages of a scene on disk before they are read: where they lie, what they draw, what their bytes were."""
