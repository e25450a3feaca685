"""Drive the device by hand: the words of ``hm drive``, its prompt, and what they make the arm do."""
