"""The console programs. Nothing else imports them."""
