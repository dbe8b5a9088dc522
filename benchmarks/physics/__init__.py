"""What the physics of trials is checked against: contacts whose answer is known, engines, hands and conditions."""
