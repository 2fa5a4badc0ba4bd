// Draws the zero level set of nested fields. Each field is twice as fine as the one around it.

#import nested
#import picture
