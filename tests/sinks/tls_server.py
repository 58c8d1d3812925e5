"""A server of TLS for the tests: writes what comes into the file `received`, and answers each line with "ok" if asked to.

    tls_server.py FOLDER CERTIFICATE KEY ACKNOWLEDGE(yes|no) [AUTHORITY of the clients that it takes]
"""
import pathlib
import socket
import ssl
import sys
import threading

folder, certificate, key, acknowledge = pathlib.Path(sys.argv[1]), sys.argv[2], sys.argv[3], sys.argv[4] == "yes"
context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
context.load_cert_chain(certificate, key)
if len(sys.argv) > 5:
    context.load_verify_locations(sys.argv[5])
    context.verify_mode = ssl.CERT_REQUIRED
port_file = folder / "port"
listener = socket.socket()
listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
listener.bind(("127.0.0.1", int(port_file.read_text()) if port_file.exists() else 0))
listener.listen()
port_file.write_text(str(listener.getsockname()[1]))
print("listening", flush=True)


def serve(raw):
    try:
        with context.wrap_socket(raw, server_side=True) as peer, open(folder / "received", "ab") as received:
            received.write(b"\n")  # ends a line that the connection before was cut off in
            while data := peer.recv(65536):
                received.write(data)
                received.flush()
                if acknowledge:
                    peer.sendall(b"ok\n" * data.count(b"\n"))
            (folder / "goodbye").write_text("yes")
    except OSError as error:
        print(error, file=sys.stderr, flush=True)


while True:
    threading.Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()
