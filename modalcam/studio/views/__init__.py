"""Pages of the studio, made with NiceGUI from the model; nothing else imports it."""
